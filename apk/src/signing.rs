//! APK signatures of the schemes 2 and 3.
//!
//! Both lie in the *signing block*, between the zip's entries and its central directory, and cover everything
//! else in the file: the entries, the directory, and the end record with the directory's place as it would be
//! without the block. Format: AOSP, "APK Signature Scheme v2" and "v3". All lengths are little-endian.

use p256::ecdsa::signature::Verifier;
use p256::ecdsa::{DerSignature, VerifyingKey};
use p256::pkcs8::DecodePublicKey;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};
use crate::key::Key;

const MAGIC: &[u8; 16] = b"APK Sig Block 42";
const SCHEME_2: u32 = 0x7109_871a;
const SCHEME_3: u32 = 0xf053_68c0;
/// ECDSA with SHA-256, the content's digest in chunks.
const ECDSA_SHA256: u32 = 0x0201;
/// Algorithms whose content digest is SHA-256 in chunks (RSA-PSS, RSA, ECDSA, DSA), as others' keys may use.
const WITH_SHA256: [u32; 4] = [0x0101, 0x0103, ECDSA_SHA256, 0x0301];
/// An attribute of scheme 2 that says which newer scheme was there too, so that it cannot be stripped.
const STRIPPING_PROTECTION: u32 = 0xbeef_f00d;
/// Android 9, the first to know scheme 3.
const FIRST_OF_SCHEME_3: u32 = 28;
const LAST_LEVEL: u32 = i32::MAX.cast_unsigned();
const CHUNK: usize = 1 << 20;

/// Signs a zip with both schemes.
///
/// # Errors
/// When the bytes are not a zip, or are signed already.
pub fn sign(zip: &[u8], key: &Key) -> Result<Vec<u8>> {
    let parts = Parts::of(zip)?;
    if parts.block.is_some() {
        return Err(malformed("is signed already"));
    }
    let digest = parts.digest();
    let digests = prefixed(&prefixed(&[&ECDSA_SHA256.to_le_bytes()[..], &prefixed(&digest)].concat()));
    let certificates = prefixed(&prefixed(key.certificate()));
    let protection = prefixed(&prefixed(&[STRIPPING_PROTECTION.to_le_bytes(), 3_u32.to_le_bytes()].concat()));
    let levels = [FIRST_OF_SCHEME_3.to_le_bytes(), LAST_LEVEL.to_le_bytes()].concat();

    let for_2 = [&digests[..], &certificates, &protection].concat();
    let for_3 = [&digests[..], &certificates, &levels, &prefixed(&[])].concat();
    let pairs =
        [pair(SCHEME_2, &signers(&for_2, &[], key)), pair(SCHEME_3, &signers(&for_3, &levels, key))].concat();

    // The size stands at both ends and counts all but its first occurrence.
    let size = (pairs.len() + 8 + MAGIC.len()) as u64;
    let block = [&size.to_le_bytes()[..], &pairs, &size.to_le_bytes(), MAGIC].concat();
    let mut signed = Vec::with_capacity(zip.len() + block.len());
    signed.extend(parts.entries);
    signed.extend(&block);
    signed.extend(parts.directory);
    let end = signed.len();
    signed.extend(parts.end);
    let place =
        u32::try_from(parts.entries.len() + block.len()).map_err(|_| malformed("is larger than 4 GiB"))?;
    signed[end + 16..end + 20].copy_from_slice(&place.to_le_bytes());
    Ok(signed)
}

/// A sequence of one signer.
fn signers(data: &[u8], levels: &[u8], key: &Key) -> Vec<u8> {
    let signature = [&ECDSA_SHA256.to_le_bytes()[..], &prefixed(&key.sign(data))].concat();
    let signer =
        [&prefixed(data)[..], levels, &prefixed(&prefixed(&signature)), &prefixed(key.public())].concat();
    prefixed(&prefixed(&signer))
}

fn prefixed(bytes: &[u8]) -> Vec<u8> {
    // What is signed here (a digest, a certificate) is small.
    [&(bytes.len() as u32).to_le_bytes()[..], bytes].concat()
}

fn pair(id: u32, value: &[u8]) -> Vec<u8> {
    [&(value.len() as u64 + 4).to_le_bytes()[..], &id.to_le_bytes(), value].concat()
}

fn malformed(problem: &str) -> Error {
    Error::malformed("APK", problem)
}

/// What is known about an APK's signatures after they were checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signatures {
    /// The schemes that are there and hold.
    pub schemes: Vec<u8>,
    /// SHA-256 of the signer's certificate, in hexadecimal: its identity for Android.
    pub certificate: String,
    /// Whether the signatures themselves were checked: those with ECDSA are. For keys of other kinds only the
    /// content's digest is.
    pub verified: bool,
}

/// Checks an APK's signatures.
///
/// # Errors
/// When there is none, when the content is not what was signed, when a signature is wrong, or when the schemes
/// name different signers.
pub fn verify(apk: &[u8]) -> Result<Signatures> {
    let parts = Parts::of(apk)?;
    let block = parts.block.ok_or_else(|| malformed("is not signed with scheme 2 or 3"))?;
    let digest = parts.digest();
    let mut found: Option<Signatures> = None;
    for (scheme, id) in [(2, SCHEME_2), (3, SCHEME_3)] {
        let Some(value) = value_of(block, id) else { continue };
        let (certificate, verified) = verify_scheme(value, scheme, &digest)?;
        match &mut found {
            None => found = Some(Signatures { schemes: vec![scheme], certificate, verified }),
            Some(signatures) if signatures.certificate == certificate => {
                signatures.schemes.push(scheme);
                signatures.verified &= verified;
            }
            Some(_) => return Err(malformed("the two signature schemes name different certificates")),
        }
    }
    found.ok_or_else(|| malformed("is not signed with scheme 2 or 3"))
}

/// The certificate's SHA-256, and whether the signature was checked.
fn verify_scheme(value: &[u8], scheme: u8, digest: &[u8]) -> Result<(String, bool)> {
    let cut = || malformed(&format!("the signature of scheme {scheme} is cut short"));
    let mut signers = Reader(value).prefixed().ok_or_else(cut)?;
    let mut signer = signers.prefixed().ok_or_else(cut)?;
    if !signers.0.is_empty() {
        return Err(malformed("has more than one signer"));
    }
    let data = signer.prefixed().ok_or_else(cut)?;
    if scheme == 3 {
        signer.take(8).ok_or_else(cut)?;
    }
    let mut signatures = signer.prefixed().ok_or_else(cut)?;
    let public = signer.prefixed().ok_or_else(cut)?;

    let mut fields = data;
    let mut digests = fields.prefixed().ok_or_else(cut)?;
    let certificate = fields.prefixed().and_then(|mut list| list.prefixed()).ok_or_else(cut)?;
    let mut matches = false;
    while !digests.0.is_empty() {
        let mut entry = digests.prefixed().ok_or_else(cut)?;
        let algorithm = entry.word().ok_or_else(cut)?;
        let stated = entry.prefixed().ok_or_else(cut)?;
        if WITH_SHA256.contains(&algorithm) {
            if stated.0 != digest {
                return Err(malformed(&format!("its content is not what scheme {scheme} signed")));
            }
            matches = true;
        }
    }
    if !matches {
        return Err(malformed(&format!(
            "scheme {scheme} has no digest with SHA-256, which this check knows"
        )));
    }
    let mut verified = false;
    while !signatures.0.is_empty() {
        let mut entry = signatures.prefixed().ok_or_else(cut)?;
        let algorithm = entry.word().ok_or_else(cut)?;
        let signature = entry.prefixed().ok_or_else(cut)?;
        if algorithm == ECDSA_SHA256
            && let Ok(key) = VerifyingKey::from_public_key_der(public.0)
        {
            DerSignature::try_from(signature.0)
                .and_then(|signature| key.verify(data.0, &signature))
                .map_err(|_| malformed(&format!("the signature of scheme {scheme} is wrong")))?;
            verified = true;
        }
    }
    let name = Sha256::digest(certificate.0).iter().map(|byte| format!("{byte:02x}")).collect();
    Ok((name, verified))
}

/// The value of an id in a signing block (without its size and magic).
fn value_of(block: &[u8], id: u32) -> Option<&[u8]> {
    let mut pairs = Reader(block);
    while !pairs.0.is_empty() {
        let size = usize::try_from(u64::from_le_bytes(pairs.take(8)?.try_into().ok()?)).ok()?;
        let mut entry = Reader(pairs.take(size)?);
        if entry.word()? == id {
            return Some(entry.0);
        }
    }
    None
}

/// Takes bytes off the front.
#[derive(Clone, Copy)]
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, size: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(size)?;
        self.0 = rest;
        Some(taken)
    }

    fn word(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    fn prefixed(&mut self) -> Option<Reader<'a>> {
        let size = usize::try_from(self.word()?).ok()?;
        self.take(size).map(Reader)
    }
}

/// A zip file's parts.
struct Parts<'a> {
    entries: &'a [u8],
    /// The pairs of the signing block.
    block: Option<&'a [u8]>,
    directory: &'a [u8],
    end: &'a [u8],
}

impl<'a> Parts<'a> {
    fn of(zip: &'a [u8]) -> Result<Self> {
        let no_zip = || malformed("is not a zip file");
        let word = |at: usize| Some(u32::from_le_bytes(zip.get(at..at + 4)?.try_into().ok()?));
        // The end record has 22 bytes and a comment, whose length is its last field.
        let end = (0..=zip.len().checked_sub(22).ok_or_else(no_zip)?)
            .rev()
            .take(1 << 16)
            .find(|&at| {
                let comment = usize::from(u16::from_le_bytes([zip[at + 20], zip[at + 21]]));
                zip[at..].starts_with(b"PK\x05\x06") && at + 22 + comment == zip.len()
            })
            .ok_or_else(no_zip)?;
        let size = word(end + 12).ok_or_else(no_zip)? as usize;
        let start = word(end + 16).ok_or_else(no_zip)? as usize;
        if start.checked_add(size) != Some(end) {
            return Err(malformed("its zip directory does not end where the end record begins"));
        }
        let before = &zip[..start];
        let (entries, block) = match before.strip_suffix(MAGIC) {
            None => (before, None),
            Some(rest) => {
                let wrong = || malformed("its signing block has a wrong size");
                let (rest, size) = rest.split_last_chunk::<8>().ok_or_else(wrong)?;
                let pairs =
                    usize::try_from(u64::from_le_bytes(*size)).ok().and_then(|size| size.checked_sub(24));
                let at = pairs.and_then(|size| rest.len().checked_sub(size)).ok_or_else(wrong)?;
                let (rest, pairs) = rest.split_at(at);
                let (entries, first) = rest.split_last_chunk::<8>().ok_or_else(wrong)?;
                if first != size {
                    return Err(wrong());
                }
                (entries, Some(pairs))
            }
        };
        Ok(Self { entries, block, directory: &zip[start..end], end: &zip[end..] })
    }

    /// SHA-256 over the SHA-256s of chunks of 1 MiB, as both schemes want it.
    fn digest(&self) -> Vec<u8> {
        let mut end = self.end.to_vec();
        // The directory counts as if it followed the entries.
        end[16..20].copy_from_slice(&(self.entries.len() as u32).to_le_bytes());
        let sections = [self.entries, self.directory, &end];
        let chunks: Vec<&[u8]> = sections.iter().flat_map(|section| section.chunks(CHUNK)).collect();
        let mut whole = Sha256::new();
        whole.update([0x5a]);
        whole.update((chunks.len() as u32).to_le_bytes());
        for chunk in chunks {
            let part = Sha256::new()
                .chain_update([0xa5])
                .chain_update((chunk.len() as u32).to_le_bytes())
                .chain_update(chunk);
            whole.update(part.finalize());
        }
        whole.finalize().to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::{Entry, pack};

    fn signed() -> (Vec<u8>, Key) {
        // More than one chunk, and not a whole number of them.
        let data = (0..CHUNK * 2 + 17).map(|i| ((i * i) >> 3) as u8).collect();
        let zip = pack(&[Entry { name: "a".into(), data, alignment: 4 }]).unwrap();
        let (key, _) = Key::generate().unwrap();
        (sign(&zip, &key).unwrap(), key)
    }

    #[test]
    fn what_is_signed_verifies() {
        let (apk, key) = signed();
        let found = verify(&apk).unwrap();
        assert_eq!(found.schemes, [2, 3]);
        assert!(found.verified);
        let name: String =
            Sha256::digest(key.certificate()).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(found.certificate, name);
        assert!(sign(&apk, &key).unwrap_err().to_string().contains("already"));
    }

    #[test]
    fn any_changed_byte_is_noticed() {
        let (apk, _) = signed();
        let magic = apk.windows(16).rposition(|window| window == MAGIC).unwrap();
        let interesting =
            (0..64).chain(CHUNK - 2..CHUNK + 2).chain(magic - 1200..magic).chain(magic + 16..apk.len());
        let mut damaged = apk.clone();
        let mut unnoticed = Vec::new();
        for at in interesting {
            damaged[at] ^= 0x40;
            if verify(&damaged).is_ok_and(|found| found.verified && found.schemes == [2, 3]) {
                unnoticed.push(at);
            }
            damaged[at] = apk[at];
        }
        // The levels of scheme 3 outside of the signed data are the installer's to compare; nothing else passes.
        assert!(unnoticed.len() <= 8, "{unnoticed:?} of {}", apk.len());
        assert!(verify(&damaged).is_ok());
    }

    #[test]
    fn a_cut_file_is_an_error() {
        let (apk, _) = signed();
        for length in (0..100).chain(apk.len() - 3000..apk.len()) {
            assert!(verify(&apk[..length]).is_err(), "{length}");
        }
        assert!(verify(b"PK\x05\x06").is_err());
    }
}
