//! The foreign calls, and nothing else: each maker's library behind safe functions, with the maker's units and codes.
//!
//! A library stays loaded as long as the process runs: some run threads of their own, from under which it is not to be taken.

#[cfg(feature = "force-dimension")]
pub(super) mod dhd;
#[cfg(feature = "open-haptics")]
pub(super) mod hd;
#[cfg(feature = "haption")]
pub(super) mod virtuose;

use std::error::Error as _;
use std::ffi::{CStr, c_char};
use std::path::{Path, PathBuf};

use super::SdkLibrary;
use crate::DeviceError;

/// A maker's library.
pub(super) struct Library {
    library: &'static libloading::Library,
    file: PathBuf,
    place: &'static SdkLibrary,
}

impl Library {
    /// The library of that file, else of that which the environment names, else the first that is found by the maker's names.
    pub fn open(place: &'static SdkLibrary, file: Option<&Path>) -> Result<Self, DeviceError> {
        let file = file.map(Path::to_path_buf);
        let file = file.or_else(|| place.named_file());
        let names = match file {
            Some(file) => vec![file],
            None => place.names.iter().map(PathBuf::from).collect(),
        };
        let mut reasons = Vec::new();
        for file in &names {
            // SAFETY: what a library does when it is loaded is its maker's; whoever names one trusts it.
            match unsafe { libloading::Library::new(file) } {
                Ok(library) => {
                    return Ok(Self { library: Box::leak(Box::new(library)), file: file.clone(), place });
                }
                // What the system says stands behind the error that says so.
                Err(error) => reasons.push(error.source().map_or(error.to_string(), ToString::to_string)),
            }
        }
        let looked_for: Vec<String> = names.iter().map(|file| format!("`{}`", file.display())).collect();
        Err(DeviceError::NotOpened {
            device: format!("the library of {} ({})", place.maker, looked_for.join(", ")),
            reason: reasons.join("; "),
            remedy: place.remedy,
        })
    }

    /// A function that it has to have.
    ///
    /// # Safety
    /// `F` is the type of a pointer to that function.
    unsafe fn needed<F: Copy>(&self, symbol: &str) -> Result<F, DeviceError> {
        // SAFETY: as the caller says.
        unsafe { self.optional(symbol) }.ok_or_else(|| DeviceError::NotOpened {
            device: format!("the library of {} (`{}`)", self.place.maker, self.file.display()),
            reason: format!("it has no function {symbol}"),
            remedy: self.place.remedy,
        })
    }

    /// A function that it may have.
    ///
    /// # Safety
    /// `F` is the type of a pointer to that function.
    unsafe fn optional<F: Copy>(&self, symbol: &str) -> Option<F> {
        // SAFETY: as the caller says; the library is never unloaded, so that the pointer stays good.
        unsafe { self.library.get::<F>(symbol) }.ok().map(|function| *function)
    }
}

/// The functions of a library by their names, each of the type that is given.
macro_rules! functions {
    (
        $table:ident: $abi:literal;
        $(fn $needed:ident($($argument:ty),*) $(-> $result:ty)?;)*
        $(optional fn $optional:ident($($of:ty),*) -> $to:ty;)*
    ) => {
        #[derive(Clone, Copy)]
        #[expect(non_snake_case, reason = "the maker's names")]
        struct $table {
            $($needed: unsafe extern $abi fn($($argument),*) $(-> $result)?,)*
            $($optional: Option<unsafe extern $abi fn($($of),*) -> $to>,)*
        }

        impl $table {
            fn resolve(library: &super::Library) -> Result<Self, crate::DeviceError> {
                // SAFETY: the types are those of the maker's header.
                unsafe {
                    Ok(Self {
                        $($needed: library.needed(stringify!($needed))?,)*
                        $($optional: library.optional(stringify!($optional)),)*
                    })
                }
            }
        }
    };
}
use functions;

/// A text of a library, as far as there is one.
///
/// # Safety
/// It is null, or ends in a zero.
unsafe fn text(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: as the caller says.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}
