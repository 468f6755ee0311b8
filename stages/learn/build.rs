//! Tells the linker where this package's tests, benches and programs will find libtorch when they run.
//!
//! torch-sys says which folder it linked against; that reaches only packages that depend on torch-sys directly, which is
//! why this one does. An rpath needs no `LD_LIBRARY_PATH`, so a stage runs alike from a shell, a test and a batch queue.
#![allow(clippy::print_stdout, reason = "a build script talks to cargo through its standard output")]

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    if let Some(folder) = std::env::var_os("DEP_TCH_LIBTORCH_LIB") {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{}", folder.to_string_lossy());
    }
}
