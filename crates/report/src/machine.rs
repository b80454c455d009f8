//! Which machine and which build of palpate measured something.

use serde::Serialize;

/// The machine and the build of palpate that this runs on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Version of palpate.
    pub palpate: &'static str,
    /// Operating system that it was built for: `linux`, `macos`, `windows`.
    pub os: &'static str,
    /// Kind of processor that it was built for: `x86_64`, `aarch64`.
    pub architecture: &'static str,
    /// Whether debug assertions are compiled in, which make it slower.
    pub debug_assertions: bool,
    /// Model of the processor, where the operating system names it (Linux).
    pub processor: Option<String>,
    /// Processors that this process may use.
    pub processors: Option<usize>,
    /// Release of the operating system's kernel (Linux).
    pub kernel: Option<String>,
}

impl Machine {
    /// This machine and build.
    pub fn this() -> Self {
        let read = |path: &str| std::fs::read_to_string(path).ok();
        Self {
            palpate: env!("CARGO_PKG_VERSION"),
            os: std::env::consts::OS,
            architecture: std::env::consts::ARCH,
            debug_assertions: cfg!(debug_assertions),
            processor: read("/proc/cpuinfo").and_then(|text| model_name(&text)),
            processors: std::thread::available_parallelism().ok().map(usize::from),
            kernel: read("/proc/sys/kernel/osrelease").map(|text| text.trim().to_owned()),
        }
    }

    /// The build as a line: version, kind of processor, operating system.
    pub fn build(&self) -> String {
        let checked = if self.debug_assertions { ", with debug assertions" } else { "" };
        format!("palpate {} for {} on {}{checked}", self.palpate, self.architecture, self.os)
    }

    /// The processor as a line.
    pub fn processor_line(&self) -> String {
        let model = self.processor.as_deref().unwrap_or("unknown model");
        match self.processors {
            Some(1) => format!("{model}, 1 processor"),
            Some(count) => format!("{model}, {count} processors"),
            None => model.to_owned(),
        }
    }
}

/// From `/proc/cpuinfo`: x86 names a model; ARM names a board, or nothing.
fn model_name(cpuinfo: &str) -> Option<String> {
    let field = |wanted: &str| {
        cpuinfo.lines().find_map(|line| {
            let (name, value) = line.split_once(':')?;
            (name.trim() == wanted && !value.trim().is_empty()).then(|| value.trim().to_owned())
        })
    };
    field("model name").or_else(|| field("Model"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_is_read_from_what_linux_writes() {
        let x86 = "processor\t: 0\nmodel\t\t: 85\nmodel name\t: Some Processor @ 2.50GHz\nprocessor\t: 1\n";
        assert_eq!(model_name(x86).as_deref(), Some("Some Processor @ 2.50GHz"));
        let board = "processor\t: 0\nBogoMIPS\t: 108.00\n\nModel\t\t: Some Board Rev 1.4\n";
        assert_eq!(model_name(board).as_deref(), Some("Some Board Rev 1.4"));
        assert_eq!(model_name("processor: 0\nmodel name:\n"), None);
        assert_eq!(model_name(""), None);
    }

    #[test]
    fn lines_hold_what_is_known() {
        let machine = Machine { processor: None, processors: Some(1), ..Machine::this() };
        assert_eq!(machine.processor_line(), "unknown model, 1 processor");
        assert!(machine.build().contains(env!("CARGO_PKG_VERSION")));
    }
}
