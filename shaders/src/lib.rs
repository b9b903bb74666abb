//! Shader sources, compiled at build time, and the layouts they share with the host.
