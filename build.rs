//! Tells the linker where the program that runs the learning stages will find libtorch.
//!
//! The package that links libtorch passes the folder on. With the engine alone (no feature `stages`) it is no dependency
//! and there is nothing to tell. An rpath needs no `LD_LIBRARY_PATH`, so the program runs alike from a shell and a queue.
#![allow(clippy::print_stdout, reason = "a build script talks to cargo through its standard output")]

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if let Some(folder) = std::env::var_os("DEP_DRIL_LEARN_LIBTORCH_LIB") {
        println!("cargo::rustc-link-arg-bin=dril-pipe-learn=-Wl,-rpath,{}", folder.to_string_lossy());
    }
}
