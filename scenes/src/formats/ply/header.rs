//! The text that begins every PLY file: which elements follow, and how they are stored.

use std::io::Cursor;
use std::path::Path;

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, Encoding, PropertyType, ScalarType};

use crate::source::Source;
use crate::{Format, SceneError};

/// A header longer than this is not one (an SH-3 Gaussian header has 1.6 kB).
const MAX_HEADER: usize = 1 << 20;

const REMEDY: &str = "Export the scene again, or convert it to another format";

/// A PLY header.
#[derive(Clone, Debug)]
pub(crate) struct Header {
    pub(crate) encoding: Encoding,
    pub(crate) elements: Vec<Element>,
    /// Where the first element's first row begins, bytes.
    pub(crate) data_offset: u64,
    /// Lines of the header.
    pub(crate) lines: usize,
}

/// One element: rows of equal layout.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
}

/// One property of an element.
#[derive(Clone, Debug)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) kind: PropertyType,
}

impl Header {
    /// Reads and checks the header.
    pub(crate) fn read(source: &Source) -> Result<Self, SceneError> {
        let head = source.head(MAX_HEADER)?;
        let mut reader = Reader::new(Cursor::new(head.as_slice()));
        let parsed = Parser::<DefaultElement>::new().read_header(&mut reader).map_err(|error| {
            let place = match error.line() {
                Some(line) => format!("header line {line}"),
                None => "header".to_owned(),
            };
            // The parser's message repeats the line, which may be a megabyte of anything.
            let message: String =
                error.to_string().chars().map(|c| if c.is_control() { ' ' } else { c }).take(200).collect();
            SceneError::malformed(source.path(), place, message, REMEDY)
        })?;
        let data_offset = reader.get_ref().position();
        let text = &head[..data_offset as usize];
        let elements: Vec<Element> = parsed
            .elements
            .into_values()
            .map(|element| Element {
                name: element.name,
                count: element.count as u64,
                properties: element
                    .properties
                    .into_values()
                    .map(|p| Property { name: p.name, kind: p.data_type })
                    .collect(),
            })
            .collect();
        // The parser keeps one of several elements or properties of equal name: that would shift every column.
        let declared = |word: &[u8]| text.split(|&b| b == b'\n').filter(|l| l.starts_with(word)).count();
        let properties: usize = elements.iter().map(|e| e.properties.len()).sum();
        if declared(b"element ") != elements.len() || declared(b"property ") != properties {
            return Err(SceneError::malformed(
                source.path(),
                "header",
                "an element or a property is declared twice",
                REMEDY,
            ));
        }
        let lines = text.iter().filter(|&&b| b == b'\n').count();
        Ok(Self { encoding: parsed.encoding, elements, data_offset, lines })
    }

    /// Which of the PLY formats this is.
    pub(crate) fn format(&self, path: &Path) -> Result<Format, SceneError> {
        if self.element("chunk").is_some() && self.element("vertex").is_some_and(|v| v.has("packed_position"))
        {
            return Ok(Format::CompressedPly);
        }
        let vertex = self.vertex(path)?;
        Ok(if vertex.has("trbf_center") || vertex.has("trbf_scale") || vertex.has("motion_0") {
            Format::SpacetimePly
        } else {
            Format::Ply
        })
    }

    /// The element with the splats.
    pub(crate) fn vertex(&self, path: &Path) -> Result<&Element, SceneError> {
        self.element("vertex").ok_or_else(|| {
            SceneError::malformed(
                path,
                "header",
                "there is no element 'vertex'",
                "This PLY holds no splats; name a Gaussian splatting scene",
            )
        })
    }

    /// The element of that name.
    pub(crate) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }
}

impl Element {
    /// Whether it has a property of that name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.properties.iter().any(|p| p.name == name)
    }

    /// Bytes of one row, at least (a list may be empty); exactly, where there is no list.
    pub(crate) fn min_row_bytes(&self) -> u64 {
        self.properties
            .iter()
            .map(|p| match &p.kind {
                PropertyType::Scalar(t) | PropertyType::List(t, _) => scalar_bytes(t) as u64,
            })
            .sum()
    }

    /// Whether every row has the same size.
    pub(crate) fn is_fixed(&self) -> bool {
        self.properties.iter().all(|p| matches!(p.kind, PropertyType::Scalar(_)))
    }
}

/// Bytes of one number.
pub(crate) fn scalar_bytes(scalar: &ScalarType) -> usize {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}
