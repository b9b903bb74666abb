//! Android's binary XML: the form in which a manifest is in an APK.
//!
//! A file is a chunk that holds a pool of strings, a map from the first strings (names of attributes) to
//! resource numbers, and one chunk for each start and end of a namespace and an element. All numbers are
//! little-endian. Layout as in AOSP, `frameworks/base/libs/androidfw/include/androidfw/ResourceTypes.h`.

use std::collections::BTreeMap;
use std::fmt::Write;

use crate::attributes::{self, Kind};
use crate::error::{Error, Result};

/// The namespace of Android's own attributes.
pub const NAMESPACE: &str = "http://schemas.android.com/apk/res/android";

const CHUNK_STRINGS: u16 = 0x0001;
const CHUNK_XML: u16 = 0x0003;
const CHUNK_NAMESPACE_START: u16 = 0x0100;
const CHUNK_NAMESPACE_END: u16 = 0x0101;
const CHUNK_ELEMENT_START: u16 = 0x0102;
const CHUNK_ELEMENT_END: u16 = 0x0103;
const CHUNK_RESOURCE_MAP: u16 = 0x0180;

/// "No string" wherever a string is referred to.
const NONE: u32 = u32::MAX;
/// Size of the part that all nodes have: chunk header, line, comment.
const NODE_HEADER: u16 = 16;
const ATTRIBUTE_SIZE: u16 = 20;
/// A flag of the pool: strings are UTF-8. Without it they are UTF-16.
const STRINGS_ARE_UTF8: u32 = 1 << 8;

/// The value of an attribute, as the system sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Value {
    /// Text.
    Text(String),
    /// A number.
    Integer(u32),
    /// A number that was written in hexadecimal, or flags.
    Hexadecimal(u32),
    /// `true` or `false`.
    Boolean(bool),
    /// The number of a resource.
    Reference(u32),
}

impl Value {
    /// `Res_value`'s type and data; text is an index into the pool.
    fn encoded(&self, text: u32) -> (u8, u32) {
        match *self {
            Self::Reference(id) => (0x01, id),
            Self::Text(_) => (0x03, text),
            Self::Integer(number) => (0x10, number),
            Self::Hexadecimal(number) => (0x11, number),
            Self::Boolean(yes) => (0x12, if yes { NONE } else { 0 }),
        }
    }

    /// As one would write it in XML.
    #[must_use]
    pub fn shown(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Integer(number) => number.to_string(),
            Self::Hexadecimal(number) => format!("{number:#x}"),
            Self::Boolean(yes) => yes.to_string(),
            Self::Reference(id) => format!("@{id:#010x}"),
        }
    }
}

/// An attribute in the binary form.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attribute {
    /// Resource number; `None` for an attribute without a namespace.
    pub id: Option<u32>,
    /// Its name, without a prefix.
    pub name: String,
    /// Its value.
    pub value: Value,
}

/// An element with everything in it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Element {
    /// Line in the source, from 1.
    pub line: u32,
    /// Name of the tag.
    pub name: String,
    /// In the order in which the system wants them: by resource number, the others last.
    pub attributes: Vec<Attribute>,
    /// The elements directly below.
    pub children: Vec<Element>,
}

impl Element {
    /// The value of an attribute.
    #[must_use]
    pub fn attribute(&self, name: &str) -> Option<&Value> {
        self.attributes.iter().find(|attribute| attribute.name == name).map(|attribute| &attribute.value)
    }

    /// All elements of a name, at any depth, this one included.
    #[must_use]
    pub fn all(&self, name: &str) -> Vec<&Element> {
        let mut found: Vec<&Element> = Vec::new();
        if self.name == name {
            found.push(self);
        }
        found.extend(self.children.iter().flat_map(|child| child.all(name)));
        found
    }

    /// As XML, for people.
    #[must_use]
    pub fn shown(&self) -> String {
        let mut text = String::new();
        self.show(&mut text, 0);
        text
    }

    fn show(&self, text: &mut String, depth: usize) {
        let indent = "  ".repeat(depth);
        let _ = write!(text, "{indent}<{}", self.name);
        for attribute in &self.attributes {
            let prefix = if attribute.id.is_some() { "android:" } else { "" };
            let _ = write!(text, " {prefix}{}=\"{}\"", attribute.name, attribute.value.shown());
        }
        if self.children.is_empty() {
            text.push_str("/>\n");
            return;
        }
        text.push_str(">\n");
        self.children.iter().for_each(|child| child.show(text, depth + 1));
        let _ = writeln!(text, "{indent}</{}>", self.name);
    }
}

/// Reads a manifest's XML into typed form.
///
/// `overrides` are attributes of Android's namespace that are set on the root element, such as the version.
///
/// # Errors
/// When it is not XML, or an attribute is unknown (see [`attributes`]) or its text does not fit its type.
pub fn parse(xml: &str, overrides: &[(&str, &str)]) -> Result<Element> {
    let document = roxmltree::Document::parse(xml)?;
    let mut root = element(&document, document.root_element())?;
    for (name, text) in overrides {
        let known = attributes::by_name(name).ok_or_else(|| problem(root.line, unknown(name)))?;
        let value = value(known.kind, text).map_err(|text| problem(root.line, text))?;
        root.attributes.retain(|attribute| attribute.id != Some(known.id));
        root.attributes.push(Attribute { id: Some(known.id), name: (*name).to_owned(), value });
    }
    sort(&mut root.attributes);
    Ok(root)
}

fn problem(line: u32, problem: String) -> Error {
    Error::Manifest { line, problem }
}

fn unknown(name: &str) -> String {
    format!(
        "the attribute android:{name} is not in apk/src/attributes.rs: add its resource number and type there"
    )
}

fn element(document: &roxmltree::Document<'_>, node: roxmltree::Node<'_, '_>) -> Result<Element> {
    let line = document.text_pos_at(node.range().start).row;
    let mut found = Vec::new();
    for attribute in node.attributes() {
        let (name, text) = (attribute.name(), attribute.value());
        found.push(match attribute.namespace() {
            None => Attribute { id: None, name: name.to_owned(), value: Value::Text(text.to_owned()) },
            Some(NAMESPACE) => {
                let known = attributes::by_name(name).ok_or_else(|| problem(line, unknown(name)))?;
                let value = value(known.kind, text)
                    .map_err(|reason| problem(line, format!("android:{name}=\"{text}\": {reason}")))?;
                Attribute { id: Some(known.id), name: name.to_owned(), value }
            }
            Some(other) => return Err(problem(line, format!("unknown namespace {other}"))),
        });
    }
    sort(&mut found);
    let mut children = Vec::new();
    for child in node.children() {
        if child.is_element() {
            children.push(element(document, child)?);
        } else if child.is_text() && child.text().is_some_and(|text| !text.trim().is_empty()) {
            return Err(problem(line, format!("text inside <{}>", node.tag_name().name())));
        }
    }
    Ok(Element { line, name: node.tag_name().name().to_owned(), attributes: found, children })
}

/// The system finds attributes by a search that relies on this order.
fn sort(attributes: &mut [Attribute]) {
    attributes.sort_by(|a, b| (a.id.unwrap_or(NONE), &a.name).cmp(&(b.id.unwrap_or(NONE), &b.name)));
}

fn value(kind: Kind, text: &str) -> Result<Value, String> {
    let among = |names: &[(&str, u32)], name: &str| {
        names.iter().find(|(known, _)| *known == name).map(|(_, value)| *value).ok_or_else(|| {
            let known: Vec<&str> = names.iter().map(|(known, _)| *known).collect();
            format!("{name:?} is none of {}", known.join(", "))
        })
    };
    let number = |text: &str| match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).ok().map(Value::Hexadecimal),
        None => text.parse::<i32>().ok().map(|number| Value::Integer(number.cast_unsigned())),
    };
    match kind {
        Kind::Text => Ok(Value::Text(text.to_owned())),
        Kind::Boolean => text.parse().map(Value::Boolean).map_err(|_| "must be true or false".to_owned()),
        Kind::Integer => number(text).ok_or_else(|| "must be a number".to_owned()),
        Kind::Any => Ok(match text.parse() {
            Ok(yes) => Value::Boolean(yes),
            Err(_) => number(text).unwrap_or_else(|| Value::Text(text.to_owned())),
        }),
        Kind::Enumeration(names) => among(names, text).map(Value::Integer),
        Kind::Flags(names) => text
            .split('|')
            .try_fold(0, |flags, name| among(names, name).map(|flag| flags | flag))
            .map(Value::Hexadecimal),
        Kind::Reference(names) => among(names, text).map(Value::Reference),
    }
}

/// Strings in the order of their first use; those with a resource number come first, in its order.
#[derive(Debug, Default)]
struct Strings {
    all: Vec<String>,
    /// Of the first strings.
    ids: Vec<u32>,
    names: BTreeMap<u32, u32>,
    plain: BTreeMap<String, u32>,
}

impl Strings {
    fn new(root: &Element) -> Self {
        let mut names = BTreeMap::new();
        collect_names(root, &mut names);
        let mut strings = Self::default();
        for (id, name) in names {
            strings.names.insert(id, index(strings.all.len()));
            strings.ids.push(id);
            strings.all.push(name);
        }
        strings
    }

    fn name(&mut self, attribute: &Attribute) -> u32 {
        match attribute.id.and_then(|id| self.names.get(&id)) {
            Some(index) => *index,
            None => self.plain(&attribute.name),
        }
    }

    fn plain(&mut self, text: &str) -> u32 {
        if let Some(index) = self.plain.get(text) {
            return *index;
        }
        let place = index(self.all.len());
        self.plain.insert(text.to_owned(), place);
        self.all.push(text.to_owned());
        place
    }

    fn encoded(&self) -> Vec<u8> {
        let mut offsets = Vec::new();
        let mut data = Vec::new();
        for text in &self.all {
            offsets.extend(index(data.len()).to_le_bytes());
            let units: Vec<u16> = text.encode_utf16().collect();
            // Lengths above 15 bits take two units.
            if units.len() > 0x7fff {
                data.extend((0x8000 | (units.len() >> 16) as u16).to_le_bytes());
            }
            data.extend((units.len() as u16).to_le_bytes());
            units.iter().chain(&[0]).for_each(|unit| data.extend(unit.to_le_bytes()));
        }
        data.resize(data.len().next_multiple_of(4), 0);
        let header: u16 = 28;
        let mut body = Vec::new();
        for field in [index(self.all.len()), 0, 0, u32::from(header) + index(offsets.len()), 0] {
            body.extend(field.to_le_bytes());
        }
        body.extend(offsets);
        body.extend(data);
        chunk(CHUNK_STRINGS, header, &body)
    }
}

fn collect_names(element: &Element, names: &mut BTreeMap<u32, String>) {
    for attribute in &element.attributes {
        if let Some(id) = attribute.id {
            names.insert(id, attribute.name.clone());
        }
    }
    element.children.iter().for_each(|child| collect_names(child, names));
}

/// Sizes here are far below 4 GiB: a manifest's text is in memory.
fn index(size: usize) -> u32 {
    u32::try_from(size).unwrap_or(NONE)
}

/// Everything after the first 8 bytes of the header is part of `body`.
fn chunk(kind: u16, header: u16, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(8 + body.len());
    bytes.extend(kind.to_le_bytes());
    bytes.extend(header.to_le_bytes());
    bytes.extend(index(8 + body.len()).to_le_bytes());
    bytes.extend(body);
    bytes
}

fn node(kind: u16, line: u32, fields: &[u32]) -> Vec<u8> {
    let words = [line, NONE].into_iter().chain(fields.iter().copied());
    chunk(kind, NODE_HEADER, &words.flat_map(u32::to_le_bytes).collect::<Vec<u8>>())
}

/// Encodes a document with this root.
#[must_use]
pub fn encode(root: &Element) -> Vec<u8> {
    let mut strings = Strings::new(root);
    let (prefix, namespace) = (strings.plain("android"), strings.plain(NAMESPACE));
    let mut nodes = node(CHUNK_NAMESPACE_START, root.line, &[prefix, namespace]);
    encode_element(root, &mut strings, namespace, &mut nodes);
    nodes.extend(node(CHUNK_NAMESPACE_END, root.line, &[prefix, namespace]));
    let mut body = strings.encoded();
    let ids: Vec<u8> = strings.ids.iter().copied().flat_map(u32::to_le_bytes).collect();
    body.extend(chunk(CHUNK_RESOURCE_MAP, 8, &ids));
    body.extend(nodes);
    chunk(CHUNK_XML, 8, &body)
}

fn encode_element(element: &Element, strings: &mut Strings, namespace: u32, nodes: &mut Vec<u8>) {
    let name = strings.plain(&element.name);
    // Where the attributes start, counted from here; their size; their number; no id, class or style attribute.
    let layout = u32::from(ATTRIBUTE_SIZE) | (u32::from(ATTRIBUTE_SIZE) << 16);
    let mut fields = vec![NONE, name, layout, index(element.attributes.len()), 0];
    for attribute in &element.attributes {
        let text = match &attribute.value {
            Value::Text(text) => strings.plain(text),
            _ => NONE,
        };
        let (kind, data) = attribute.value.encoded(text);
        fields.extend([
            if attribute.id.is_some() { namespace } else { NONE },
            strings.name(attribute),
            text,
            // Size of a value (8), a zero byte, the type.
            8 | (u32::from(kind) << 24),
            data,
        ]);
    }
    nodes.extend(node(CHUNK_ELEMENT_START, element.line, &fields));
    element.children.iter().for_each(|child| encode_element(child, strings, namespace, nodes));
    nodes.extend(node(CHUNK_ELEMENT_END, element.line, &[NONE, name]));
}

/// Reads a binary document, also one that other tools wrote.
///
/// # Errors
/// When it is not such a document, or is cut short.
pub fn decode(bytes: &[u8]) -> Result<Element> {
    decode_document(bytes)
        .ok_or_else(|| Error::malformed("binary manifest", "not Android's binary XML, or cut short"))
}

fn decode_document(bytes: &[u8]) -> Option<Element> {
    if half(bytes, 0)? != CHUNK_XML {
        return None;
    }
    let bytes = bytes.get(..usize::try_from(word(bytes, 4)?).ok()?)?;
    let mut strings = Vec::new();
    let mut ids = Vec::new();
    // The innermost element last; a document that holds the root is the outermost.
    let mut open = vec![Element::default()];
    let mut at = usize::from(half(bytes, 2)?);
    while at < bytes.len() {
        let size = usize::try_from(word(bytes, at + 4)?).ok()?;
        let header = usize::from(half(bytes, at + 2)?);
        let chunk = bytes.get(at..at.checked_add(size)?)?;
        if size < 8 || header < 8 {
            return None;
        }
        match half(chunk, 0)? {
            CHUNK_STRINGS => strings = decode_strings(chunk)?,
            CHUNK_RESOURCE_MAP => {
                ids = chunk[8..].chunks_exact(4).filter_map(|word_| word(word_, 0)).collect()
            }
            CHUNK_ELEMENT_START => open.push(decode_element(chunk, header, &strings, &ids)?),
            CHUNK_ELEMENT_END => {
                let closed = open.pop()?;
                open.last_mut()?.children.push(closed);
            }
            _ => {}
        }
        at += size;
    }
    let mut document = open.pop()?;
    (open.is_empty() && document.children.len() == 1).then(|| document.children.pop()).flatten()
}

fn decode_element(chunk: &[u8], header: usize, strings: &[String], ids: &[u32]) -> Option<Element> {
    let text = |index: u32| strings.get(usize::try_from(index).ok()?).cloned();
    let body = chunk.get(header..)?;
    let start = usize::from(half(body, 8)?);
    let size = usize::from(half(body, 10)?);
    let mut attributes = Vec::new();
    for number in 0..usize::from(half(body, 12)?) {
        let field = |place: usize| word(body, start + number * size + place);
        let name = field(4)?;
        let data = field(16)?;
        attributes.push(Attribute {
            id: if field(0)? == NONE { None } else { ids.get(usize::try_from(name).ok()?).copied() },
            name: text(name)?,
            value: match field(12)? >> 24 {
                0x01 => Value::Reference(data),
                0x03 => Value::Text(text(data)?),
                0x11 => Value::Hexadecimal(data),
                0x12 => Value::Boolean(data != 0),
                _ => Value::Integer(data),
            },
        });
    }
    Some(Element { line: word(chunk, 8)?, name: text(word(body, 4)?)?, attributes, children: Vec::new() })
}

fn decode_strings(chunk: &[u8]) -> Option<Vec<String>> {
    let count = usize::try_from(word(chunk, 8)?).ok()?;
    let utf8 = word(chunk, 16)? & STRINGS_ARE_UTF8 != 0;
    let data = usize::try_from(word(chunk, 20)?).ok()?;
    let offsets = chunk.get(28..28usize.checked_add(count.checked_mul(4)?)?)?;
    offsets
        .chunks_exact(4)
        .map(|offset| {
            let at = data.checked_add(usize::try_from(word(offset, 0)?).ok()?)?;
            if utf8 { decode_utf8(chunk.get(at..)?) } else { decode_utf16(chunk.get(at..)?) }
        })
        .collect()
}

/// Number of UTF-16 units, number of bytes (each one byte, or two when the first has its top bit set), bytes.
fn decode_utf8(bytes: &[u8]) -> Option<String> {
    let length = |at: usize| {
        let first = usize::from(*bytes.get(at)?);
        if first & 0x80 == 0 {
            return Some((first, at + 1));
        }
        Some(((first & 0x7f) << 8 | usize::from(*bytes.get(at + 1)?), at + 2))
    };
    let (_, at) = length(0)?;
    let (size, at) = length(at)?;
    String::from_utf8(bytes.get(at..at.checked_add(size)?)?.to_vec()).ok()
}

/// Number of units (one unit, or two when the first has its top bit set), units.
fn decode_utf16(bytes: &[u8]) -> Option<String> {
    let first = usize::from(half(bytes, 0)?);
    let (length, at): (usize, usize) = if first & 0x8000 == 0 {
        (first, 2)
    } else {
        ((first & 0x7fff) << 16 | usize::from(half(bytes, 2)?), 4)
    };
    let units: Vec<u16> = bytes
        .get(at..at.checked_add(length.checked_mul(2)?)?)?
        .chunks_exact(2)
        .filter_map(|pair| half(pair, 0))
        .collect();
    String::from_utf16(&units).ok()
}

fn half(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(at..at.checked_add(2)?)?.try_into().ok()?))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = r#"<manifest xmlns:android="http://schemas.android.com/apk/res/android" package="a.b">
  <uses-sdk android:targetSdkVersion="34" android:minSdkVersion="32"/>
  <application android:label="Ümlaut" android:hasCode="false">
    <meta-data android:name="n" android:value="a|b"/>
    <activity android:configChanges="density|uiMode" android:launchMode="singleTask"
      android:theme="@android:style/Theme.Black.NoTitleBar.Fullscreen"/>
    <uses-feature android:version="0x401000"/>
  </application>
</manifest>"#;

    #[test]
    fn encoding_and_decoding_agree() {
        let parsed = parse(SMALL, &[("versionName", "1.2.3"), ("versionCode", "7")]).unwrap();
        let decoded = decode(&encode(&parsed)).unwrap();
        assert_eq!(decoded, parsed);
        assert_eq!(decoded.attribute("versionCode"), Some(&Value::Integer(7)));
        assert_eq!(decoded.attribute("package"), Some(&Value::Text("a.b".into())));
        let activity = decoded.all("activity")[0];
        assert_eq!(activity.line, 5);
        assert_eq!(activity.attribute("configChanges"), Some(&Value::Hexadecimal(0x1200)));
        assert_eq!(activity.attribute("launchMode"), Some(&Value::Integer(2)));
        assert_eq!(activity.attribute("theme"), Some(&Value::Reference(0x0103_000a)));
        assert_eq!(decoded.all("application")[0].attribute("label"), Some(&Value::Text("Ümlaut".into())));
        assert_eq!(
            decoded.all("uses-feature")[0].attribute("version"),
            Some(&Value::Hexadecimal(0x0040_1000))
        );
        // Sorted by number, whatever the order in the text.
        let sdk: Vec<&str> = decoded.all("uses-sdk")[0].attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(sdk, ["minSdkVersion", "targetSdkVersion"]);
    }

    #[test]
    fn what_the_system_would_ignore_is_refused() {
        let failure = |attribute: &str| {
            let xml = format!("<a xmlns:android=\"{NAMESPACE}\">\n<b {attribute}/></a>");
            parse(&xml, &[]).unwrap_err().to_string()
        };
        assert!(failure("android:labell='x'").contains("line 2"));
        assert!(failure("android:labell='x'").contains("labell"));
        assert!(failure("android:hasCode='yes'").contains("true or false"));
        assert!(failure("android:minSdkVersion='new'").contains("number"));
        assert!(failure("android:launchMode='single'").contains("singleTask"));
        assert!(failure("xmlns:o='other' o:x='1'").contains("other"));
        assert!(parse("<a>text</a>", &[]).is_err());
        assert!(parse("<a", &[]).is_err());
        assert!(parse("<a/>", &[("nothing", "1")]).is_err());
    }

    #[test]
    fn a_cut_document_is_an_error_and_never_a_panic() {
        let whole = encode(&parse(SMALL, &[]).unwrap());
        assert!(decode(&whole).is_ok());
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "{length}");
        }
        // Any single byte overwritten: an error or a document.
        let mut damaged = whole.clone();
        for place in 0..whole.len() {
            for value in [0x00, 0x7f, 0xff] {
                damaged[place] = value;
                let _ = decode(&damaged);
            }
            damaged[place] = whole[place];
        }
    }
}
