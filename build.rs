//! Tells the linker where the programs will find libtorch, and says early and plainly when there is none.
//!
//! The bindings to libtorch are built at the same time and would fail with a page of C++ errors; this script depends on
//! nothing, so it is done within the first second and its message is the one that is seen.
#![allow(clippy::print_stdout, reason = "a build script talks to cargo through its standard output")]

use std::env;
use std::path::PathBuf;
use std::process::Command;

fn main() {
    for name in ["LIBTORCH", "LIBTORCH_LIB", "LIBTORCH_USE_PYTORCH", "VIRTUAL_ENV"] {
        println!("cargo::rerun-if-env-changed={name}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    // Without the stages (the engine alone) nothing links libtorch.
    if env::var_os("CARGO_FEATURE_STAGES").is_none() {
        return;
    }
    match libraries() {
        Ok(folder) => {
            println!("cargo::rerun-if-changed={}", folder.join("libtorch_cpu.so").display());
            println!("cargo::rustc-link-arg-bins=-Wl,-rpath,{}", folder.display());
        }
        Err(message) => println!("cargo::error={message}"),
    }
}

/// The folder of libtorch's libraries, found by the same rules as the bindings (the torch-sys crate) follow.
fn libraries() -> Result<PathBuf, String> {
    if env::var_os("LIBTORCH_USE_PYTORCH").is_some() {
        return from_python();
    }
    let Some(home) = env::var_os("LIBTORCH_LIB").or_else(|| env::var_os("LIBTORCH")).map(PathBuf::from)
    else {
        return Err(
            "LIBTORCH is not set: build inside the project's folder, whose `.cargo/config.toml` sets it"
                .into(),
        );
    };
    let folder = home.join("lib");
    if folder.is_dir() {
        return Ok(folder);
    }
    Err(format!(
        "no libtorch in `{}`: run `cargo xtask libtorch` first (once; it downloads 540 MB)",
        home.display()
    ))
}

fn from_python() -> Result<PathBuf, String> {
    let python = if env::var_os("VIRTUAL_ENV").is_some() { "python" } else { "python3" };
    let script = "import os, torch; print(os.path.join(os.path.dirname(torch.__file__), 'lib'))";
    let output =
        Command::new(python).args(["-c", script]).output().ok().filter(|output| output.status.success());
    let path = output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned());
    path.map(PathBuf::from).ok_or_else(|| {
        format!("LIBTORCH_USE_PYTORCH is set, but `{python}` cannot import torch: `{python} -m pip install torch==2.13.0`")
    })
}
