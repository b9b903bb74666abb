//! The `motes` command's parts, shared with the tests.

pub mod commands;
pub mod measure;
