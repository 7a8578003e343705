//! The name under which programs ask for the shared library: cargo gives it none.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // The number is that of SPIVCAL_ABI_VERSION.
    let argument = match std::env::var("CARGO_CFG_TARGET_OS").as_deref() {
        Ok("linux" | "android" | "freebsd" | "netbsd" | "openbsd") => "-Wl,-soname,libspivcal.so.1",
        Ok("macos") => "-Wl,-install_name,@rpath/libspivcal.1.dylib",
        _ => return,
    };
    println!("cargo:rustc-cdylib-link-arg={argument}");
}
