//! Hands the linker the memory layout, which lies at the top of the repository.

use std::path::PathBuf;

fn main() {
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    std::fs::copy("../memory.x", out.join("memory.x")).expect("memory.x lies at the top of the repository");
    println!("cargo:rerun-if-changed=../memory.x");
    println!("cargo:rustc-link-search={}", out.display());
    for argument in ["--nmagic", "--build-id=sha1", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}
