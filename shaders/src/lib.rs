//! Shader sources, compiled to SPIR-V at build time, and the layouts that they share with the host.

pub mod layout;

/// The compiled shaders, one constant each.
pub mod modules {
    const fn spirv<const BYTES: usize, const WORDS: usize>(bytes: &[u8; BYTES]) -> [u32; WORDS] {
        assert!(BYTES == WORDS * 4);
        let mut words = [0; WORDS];
        let mut i = 0;
        while i < WORDS {
            words[i] =
                u32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]);
            i += 1;
        }
        words
    }
    include!(concat!(env!("OUT_DIR"), "/modules.rs"));
}
