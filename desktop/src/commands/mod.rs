//! What the `motes` command can do, one module per subcommand: each has its arguments and a `run`.

pub mod animate;
pub mod bench;
pub mod compare;
pub mod device;
pub mod digest;
pub mod golden;
pub mod info;
pub mod label;
pub mod lod;
pub mod lod_walk;
pub mod optimize;
pub mod plan;
pub mod render;
pub mod view;
pub mod xr;
