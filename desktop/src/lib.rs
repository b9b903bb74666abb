//! The `motes` command's parts, shared with the tests.
