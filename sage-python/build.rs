//! Links the module small: functions with the same code are kept once.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rustc-cdylib-link-arg=-Wl,--icf=all");
}
