//! The `motes` command's parts, shared with the tests.

pub mod bench;
pub mod commands;
pub mod config_args;
pub mod density;
pub mod error;
pub mod heat;
pub mod judge;
pub mod lod;
pub mod marking;
pub mod measure;
pub mod replay;
pub mod scene_args;
pub mod shots;
pub mod studio;
pub mod vantage;
pub mod video;
pub mod window;
