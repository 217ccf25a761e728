//! Writes the JavaScript that calls the WebAssembly of the package `web`, and the WebAssembly with
//! what it needs for that.
//!
//! ```text
//! web-bindgen web.wasm DIRECTORY    writes web.js, web.d.ts and web_bg.wasm
//! ```
//!
//! The program `wasm-bindgen` does the same, and takes three times as long to compile: it has a
//! web server for tests.

use anyhow::{Context, Result};
use wasm_bindgen_cli_support::Bindgen;

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1);
    let mut argument = || arguments.next().context("usage: web-bindgen web.wasm DIRECTORY");
    let (input, directory) = (argument()?, argument()?);
    Bindgen::new().input_path(input).web(true)?.typescript(true).generate(directory)
}
