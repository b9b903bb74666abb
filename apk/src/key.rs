//! The debug key: an ECDSA key on P-256 with a certificate for itself, made once and kept.
//!
//! A device updates an application only when the certificate is the one that it was installed with, so the key
//! must outlive the checkout.

use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

use p256::SecretKey;
use p256::ecdsa::signature::Signer;
use p256::ecdsa::{DerSignature, SigningKey};
use p256::elliptic_curve::Generate;
use p256::pkcs8::{DecodePrivateKey, EncodePrivateKey, EncodePublicKey, LineEnding};
use x509_cert::Certificate;
use x509_cert::builder::profile::BuilderProfile;
use x509_cert::builder::{Builder, CertificateBuilder};
use x509_cert::der::{Decode, DecodePem, Encode, EncodePem};
use x509_cert::ext::Extension;
use x509_cert::name::Name;
use x509_cert::serial_number::SerialNumber;
use x509_cert::spki::{SubjectPublicKeyInfo, SubjectPublicKeyInfoRef};
use x509_cert::time::Validity;

use crate::error::{Error, Result};

/// A key that signs, and its certificate.
#[derive(Debug)]
pub struct Key {
    signing: SigningKey,
    certificate: Vec<u8>,
    public: Vec<u8>,
}

/// A certificate without extensions: Android reads nothing but the key.
struct Plain(Name);

impl BuilderProfile for Plain {
    fn get_issuer(&self, subject: &Name) -> Name {
        subject.clone()
    }

    fn get_subject(&self) -> Name {
        self.0.clone()
    }

    fn build_extensions(
        &self,
        _: SubjectPublicKeyInfoRef<'_>,
        _: SubjectPublicKeyInfoRef<'_>,
        _: &x509_cert::certificate::TbsCertificate,
    ) -> x509_cert::builder::Result<Vec<Extension>> {
        Ok(Vec::new())
    }
}

fn wrong(error: impl std::fmt::Display) -> Error {
    Error::Key(error.to_string())
}

impl Key {
    /// Makes a new key, valid for 30 years from now.
    ///
    /// # Errors
    /// When the system has no random numbers.
    pub fn generate() -> Result<(Self, String)> {
        const YEAR: u64 = 31_557_600;
        let secret = SecretKey::try_generate().map_err(wrong)?;
        let signing = SigningKey::from(&secret);
        let public = secret.public_key().to_public_key_der().map_err(wrong)?;
        let public = SubjectPublicKeyInfo::from_der(public.as_bytes()).map_err(wrong)?;
        let name = Name::from_str("CN=Motes debug key").map_err(wrong)?;
        let validity = Validity::from_now(Duration::from_secs(30 * YEAR)).map_err(wrong)?;
        let certificate = CertificateBuilder::new(Plain(name), SerialNumber::from(1_u32), validity, public)
            .and_then(|builder| builder.build::<_, DerSignature>(&signing))
            .map_err(wrong)?;
        let secret = secret.to_pkcs8_pem(LineEnding::LF).map_err(wrong)?;
        let text = format!("{}{}", secret.as_str(), certificate.to_pem(LineEnding::LF).map_err(wrong)?);
        Ok((Self::from_pem(&text)?, text))
    }

    /// Reads a private key (PKCS #8, P-256) and its certificate, both in PEM form in one text.
    ///
    /// # Errors
    /// When one is missing, is of another kind, or they do not belong together.
    pub fn from_pem(text: &str) -> Result<Self> {
        let block = |label: &str| {
            let (begin, end) = (format!("-----BEGIN {label}-----"), format!("-----END {label}-----"));
            let start = text.find(&begin)?;
            let stop = start + text[start..].find(&end)? + end.len();
            Some(format!("{}\n", &text[start..stop]))
        };
        let missing = |label: &str| Error::Key(format!("there is no block {label}"));
        let secret = block("PRIVATE KEY").ok_or_else(|| missing("PRIVATE KEY"))?;
        let secret = SecretKey::from_pkcs8_pem(&secret)
            .map_err(|error| Error::Key(format!("the private key is not an ECDSA key on P-256: {error}")))?;
        let certificate = block("CERTIFICATE").ok_or_else(|| missing("CERTIFICATE"))?;
        let certificate = Certificate::from_pem(certificate).map_err(wrong)?;
        let public = secret.public_key().to_public_key_der().map_err(wrong)?.as_bytes().to_vec();
        let certified = certificate.tbs_certificate().subject_public_key_info().to_der().map_err(wrong)?;
        if certified != public {
            return Err(Error::Key("the certificate is for another key".into()));
        }
        let certificate = certificate.to_der().map_err(wrong)?;
        Ok(Self { signing: SigningKey::from(&secret), certificate, public })
    }

    /// Reads the key in a file; makes both when there is no such file. The second value tells whether it is new.
    ///
    /// # Errors
    /// When the file cannot be read or written, or holds no key.
    pub fn at(file: &Path) -> Result<(Self, bool)> {
        match std::fs::read_to_string(file) {
            Ok(text) => Ok((Self::from_pem(&text)?, false)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let (key, text) = Self::generate()?;
                if let Some(folder) = file.parent() {
                    std::fs::create_dir_all(folder).map_err(Error::file(folder))?;
                }
                write_private(file, &text).map_err(Error::file(file))?;
                Ok((key, true))
            }
            Err(error) => Err(Error::file(file)(error)),
        }
    }

    /// The certificate, DER.
    #[must_use]
    pub fn certificate(&self) -> &[u8] {
        &self.certificate
    }

    /// The public key as SubjectPublicKeyInfo, DER.
    #[must_use]
    pub fn public(&self) -> &[u8] {
        &self.public
    }

    /// ECDSA with SHA-256, DER; the same for the same message.
    #[must_use]
    pub fn sign(&self, message: &[u8]) -> Vec<u8> {
        let signature: DerSignature = self.signing.sign(message);
        signature.as_bytes().to_vec()
    }
}

/// Writes a file that nobody else may read, and that must not be there yet.
fn write_private(file: &Path, text: &str) -> std::io::Result<()> {
    use std::io::Write;
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.mode(0o600);
    }
    options.open(file)?.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_made_once_and_read_back() {
        let folder = std::env::temp_dir().join(format!("motes-apk-key-{}", std::process::id()));
        let file = folder.join("below/key.pem");
        let (first, is_new) = Key::at(&file).unwrap();
        assert!(is_new);
        let (second, is_new) = Key::at(&file).unwrap();
        assert!(!is_new);
        assert_eq!(first.certificate(), second.certificate());
        assert_eq!(first.sign(b"x"), second.sign(b"x"));
        assert_ne!(first.sign(b"x"), first.sign(b"y"));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_is_no_key_is_named() {
        let (_, text) = Key::generate().unwrap();
        let (_, other) = Key::generate().unwrap();
        let certificate = text.find("-----BEGIN CERTIFICATE").unwrap();
        let failure = |text: &str| Key::from_pem(text).unwrap_err().to_string();
        assert!(failure(&text[..certificate]).contains("CERTIFICATE"));
        assert!(failure(&text[certificate..]).contains("PRIVATE KEY"));
        let mixed =
            format!("{}{}", &text[..certificate], &other[other.find("-----BEGIN CERTIFICATE").unwrap()..]);
        assert!(failure(&mixed).contains("another key"));
        assert!(
            failure(&text.replace("BEGIN PRIVATE KEY-----\n", "BEGIN PRIVATE KEY-----\nAAAA"))
                .contains("P-256")
        );
    }
}
