//! The foreign calls alone: each maker's library behind safe functions, in the maker's units and codes.
//!
//! A library stays loaded as long as the process runs: some run threads of their own, which must not lose
//! their code.

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
    /// Loads `file`, or the file that the environment variable names, or the first that is found under the
    /// maker's names.
    pub fn open(place: &'static SdkLibrary, file: Option<&Path>) -> Result<Self, DeviceError> {
        let file = file.map(Path::to_path_buf);
        let file = file.or_else(|| place.named_file());
        let names = match file {
            Some(file) => vec![file],
            None => place.names.iter().map(PathBuf::from).collect(),
        };
        let mut reasons = Vec::new();
        for file in &names {
            // SAFETY: loading runs the library's own initialisation; whoever names a library trusts it.
            match unsafe { libloading::Library::new(file) } {
                Ok(library) => {
                    return Ok(Self { library: Box::leak(Box::new(library)), file: file.clone(), place });
                }
                // The source of the error has the system's words.
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

    /// A function that the library must have.
    ///
    /// # Safety
    /// `F` must be the type of a pointer to that function.
    unsafe fn needed<F: Copy>(&self, symbol: &str) -> Result<F, DeviceError> {
        // SAFETY: as the caller guarantees.
        unsafe { self.optional(symbol) }.ok_or_else(|| DeviceError::NotOpened {
            device: format!("the library of {} (`{}`)", self.place.maker, self.file.display()),
            reason: format!("it has no function {symbol}"),
            remedy: self.place.remedy,
        })
    }

    /// A function that the library may have.
    ///
    /// # Safety
    /// `F` must be the type of a pointer to that function.
    unsafe fn optional<F: Copy>(&self, symbol: &str) -> Option<F> {
        // SAFETY: as the caller guarantees; the library is never unloaded, so the pointer stays valid.
        unsafe { self.library.get::<F>(symbol) }.ok().map(|function| *function)
    }
}

/// Table of a library's functions by name, each with its type.
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

/// Copies a text of the library; empty if the pointer is null.
///
/// # Safety
/// `text` must be null or zero-terminated.
unsafe fn text(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    // SAFETY: as the caller guarantees.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}
