//! Tells the linker where this package's tests and benches will find libtorch when they run, and passes the folder on to
//! the package with the programs.
//!
//! torch-sys says which folder it linked against; cargo hands that to direct dependents only, which is why this package
//! names torch-sys and has a `links` key of its own.
#![allow(clippy::print_stdout, reason = "a build script talks to cargo through its standard output")]

use std::path::Path;

/// The version that torch-sys is made for, which it checks itself.
const BOUND: &str = "2.13.0";

/// The version that stands beside the libraries; a Python package says it in another file.
fn version(lib: &Path) -> String {
    let said = lib
        .parent()
        .map(|root| root.join("build-version"))
        .and_then(|file| std::fs::read_to_string(file).ok());
    said.map_or_else(|| BOUND.to_owned(), |text| text.trim().to_owned())
}

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if let Some(folder) = std::env::var_os("DEP_TCH_LIBTORCH_LIB") {
        let folder = folder.to_string_lossy();
        println!("cargo::rustc-link-arg=-Wl,-rpath,{folder}");
        println!("cargo::metadata=libtorch_lib={folder}");
        println!("cargo::rustc-env=DRIL_LIBTORCH={}", version(Path::new(&*folder)));
    } else {
        println!("cargo::rustc-env=DRIL_LIBTORCH={BOUND}");
    }
}
