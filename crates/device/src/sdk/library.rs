//! Libraries of the makers' SDKs, listed whether or not their drivers are compiled in.

use std::path::PathBuf;

/// The library of a maker's SDK: its file names, and the environment variable that overrides them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SdkLibrary {
    /// The maker of the devices.
    pub maker: &'static str,
    /// Cargo feature of the driver, which is also the kind in addresses.
    pub feature: &'static str,
    /// Whether this build has the feature.
    pub compiled_in: bool,
    /// Environment variable that names the library's file.
    pub variable: &'static str,
    /// File names that the maker uses on this system, in the order in which they are tried.
    pub names: &'static [&'static str],
    /// What the user can do if the library is not found.
    pub remedy: &'static str,
}

impl SdkLibrary {
    /// Force Dimension's library.
    pub const FORCE_DIMENSION: Self = Self {
        maker: "Force Dimension",
        feature: "force-dimension",
        compiled_in: cfg!(feature = "force-dimension"),
        variable: "PALPATE_DHD_LIBRARY",
        names: if cfg!(windows) {
            &["dhd64.dll", "drd64.dll", "dhd.dll", "drd.dll"]
        } else if cfg!(target_os = "macos") {
            &["libdhd.3.dylib", "libdhd.dylib", "libdrd.3.dylib", "libdrd.dylib"]
        } else {
            &["libdhd.so.3", "libdhd.so", "libdrd.so.3", "libdrd.so"]
        },
        remedy: "install Force Dimension's SDK, or say where its library is: PALPATE_DHD_LIBRARY=FILE or force-dimension:@FILE",
    };
    /// 3D Systems' OpenHaptics.
    pub const OPEN_HAPTICS: Self = Self {
        maker: "3D Systems",
        feature: "open-haptics",
        compiled_in: cfg!(feature = "open-haptics"),
        variable: "PALPATE_HD_LIBRARY",
        names: if cfg!(windows) {
            &["HD.dll"]
        } else if cfg!(target_os = "macos") {
            &["libHD.dylib"]
        } else {
            &["libHD.so", "libHD.so.3.4", "libHD.so.3.0"]
        },
        remedy: "install OpenHaptics, or say where its library is: PALPATE_HD_LIBRARY=FILE or open-haptics:@FILE",
    };
    /// Haption's VirtuoseAPI.
    pub const HAPTION: Self = Self {
        maker: "Haption",
        feature: "haption",
        compiled_in: cfg!(feature = "haption"),
        variable: "PALPATE_VIRTUOSE_LIBRARY",
        names: if cfg!(windows) {
            &["virtuoseAPI.dll"]
        } else if cfg!(target_os = "macos") {
            &["libVirtuoseAPI.dylib"]
        } else {
            &["libVirtuoseAPI.so", "libvirtuose.so"]
        },
        remedy: "install Haption's SDK, or say where its library is: PALPATE_VIRTUOSE_LIBRARY=FILE or haption:HOST@FILE",
    };
    /// The libraries of all makers.
    pub const ALL: [Self; 3] = [Self::FORCE_DIMENSION, Self::OPEN_HAPTICS, Self::HAPTION];

    /// The file that the environment variable names, if it is set.
    pub fn named_file(&self) -> Option<PathBuf> {
        std::env::var_os(self.variable).filter(|file| !file.is_empty()).map(PathBuf::from)
    }
}
