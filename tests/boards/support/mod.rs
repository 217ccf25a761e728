//! What several files of tests share.

pub mod update_bench;
pub mod update_files;
