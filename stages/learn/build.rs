//! Tells the linker where this package's tests and benches will find libtorch when they run, and passes the folder on to
//! the package with the programs.
//!
//! torch-sys says which folder it linked against; cargo hands that to direct dependents only, which is why this package
//! names torch-sys and has a `links` key of its own.
#![allow(clippy::print_stdout, reason = "a build script talks to cargo through its standard output")]

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if let Some(folder) = std::env::var_os("DEP_TCH_LIBTORCH_LIB") {
        let folder = folder.to_string_lossy();
        println!("cargo::rustc-link-arg=-Wl,-rpath,{folder}");
        println!("cargo::metadata=libtorch_lib={folder}");
    }
}
