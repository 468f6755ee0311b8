//! The three Python wheels that libtorch is taken from, pinned by hash, and the members that are needed.
//!
//! torch's own wheel is built for CUDA; its CPU library still refers to the CUDA run-time and profiling libraries when
//! it is loaded, which explains the two small packages next to it (the versions that torch's metadata asks for).
//! Everything that talks to a GPU stays behind, so torch-sys links for the CPU.

/// The only version that the tch crate of this workspace can be built with.
pub const VERSION: &str = "2.13.0";

/// One wheel: a version, the hash of the one file, and what to take out of it.
pub struct Wheel {
    /// Name as an index knows it.
    pub package: &'static str,
    /// Exact version.
    pub version: &'static str,
    /// SHA-256 of the wheel, in hex; another file is refused by pip.
    pub sha256: &'static str,
    /// `(member, destination)`, the latter below the target folder; a trailing `/` means the whole folder.
    pub members: &'static [(&'static str, &'static str)],
}

/// What makes up a libtorch for the CPU on x86-64 Linux.
pub const WHEELS: [Wheel; 3] = [
    Wheel {
        package: "torch",
        version: VERSION,
        sha256: "60fcdcb2f3876e21146cb4524ef06397d727ca9ad5f020818547e25075fe3cb7",
        members: &[
            ("torch/include/", "include/"),
            ("torch/lib/libc10.so", "lib/libc10.so"),
            ("torch/lib/libtorch_cpu.so", "lib/libtorch_cpu.so"),
            ("torch/lib/libgomp.so.1", "lib/libgomp.so.1"),
        ],
    },
    Wheel {
        package: "nvidia-cuda-cupti",
        version: "13.0.85",
        sha256: "4eb01c08e859bf924d222250d2e8f8b8ff6d3db4721288cf35d14252a4d933c8",
        members: &[("nvidia/cu13/lib/libcupti.so.13", "lib/libcupti.so.13")],
    },
    Wheel {
        package: "nvidia-cuda-runtime",
        version: "13.0.96",
        sha256: "7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548",
        members: &[("nvidia/cu13/lib/libcudart.so.13", "lib/libcudart.so.13")],
    },
];

/// pip's options that select the same files whatever Python runs it.
pub const SELECTION: [&str; 9] = [
    "--no-deps",
    "--require-hashes",
    "--only-binary=:all:",
    "--implementation=cp",
    "--python-version=3.11",
    "--abi=cp311",
    "--platform=manylinux_2_28_x86_64",
    "--platform=manylinux_2_25_x86_64",
    "--platform=manylinux2014_x86_64",
];

/// True for the text of a version file with our version: `2.13.0` or, with a build tag, `2.13.0+cu130`.
pub fn is_right_version(text: &str) -> bool {
    text.trim().split('+').next() == Some(VERSION)
}

/// Text of the requirements file, one hash-pinned line a wheel.
pub fn requirements() -> String {
    let line =
        |wheel: &Wheel| format!("{}=={} --hash=sha256:{}\n", wheel.package, wheel.version, wheel.sha256);
    WHEELS.iter().map(line).collect()
}

/// Arguments of the unpacking script: three for every member (start of the wheel's file name, member, destination).
pub fn members() -> Vec<String> {
    let of = |wheel: &'static Wheel| {
        let file = format!("{}-{}", wheel.package.replace('-', "_"), wheel.version);
        wheel.members.iter().flat_map(move |(from, to)| [file.clone(), (*from).to_owned(), (*to).to_owned()])
    };
    WHEELS.iter().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_requirement_pins_one_version_and_one_hash() {
        let text = requirements();
        assert_eq!(text.lines().count(), WHEELS.len());
        for line in text.lines() {
            let (name, hash) = line.split_once(" --hash=sha256:").unwrap();
            assert_eq!(name.split("==").count(), 2, "{line}");
            assert!(hash.len() == 64 && hash.chars().all(|c| c.is_ascii_hexdigit()), "{line}");
        }
    }

    #[test]
    fn only_libraries_of_the_cpu_are_taken_and_a_folder_stays_a_folder() {
        let all = members();
        assert_eq!(all.len() % 3, 0);
        for triple in all.chunks_exact(3) {
            assert_eq!(triple[1].ends_with('/'), triple[2].ends_with('/'), "{triple:?}");
            assert!(!triple[1].contains("torch_cuda") && !triple[1].ends_with("lib/"), "{triple:?}");
        }
    }

    #[test]
    fn a_member_names_its_wheel_by_the_start_of_the_file_name() {
        let all = members();
        assert!(all.contains(&"nvidia_cuda_cupti-13.0.85".to_owned()));
        assert!(all.contains(&"torch-2.13.0".to_owned()));
    }
}
