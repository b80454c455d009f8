//! Description of the machine and of the build of palpate.

use serde::Serialize;

/// Machine and build of palpate on which the program runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Version of palpate.
    pub palpate: &'static str,
    /// Target operating system: `linux`, `macos`, `windows`.
    pub os: &'static str,
    /// Target architecture: `x86_64`, `aarch64`.
    pub architecture: &'static str,
    /// Whether debug assertions are compiled in; they make the program slower.
    pub debug_assertions: bool,
    /// Model of the processor, if the operating system reports it (Linux).
    pub processor: Option<String>,
    /// Number of processors that this process may use.
    pub processors: Option<usize>,
    /// Release of the operating system's kernel (Linux).
    pub kernel: Option<String>,
}

impl Machine {
    /// Returns a description of this machine and build.
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

    /// Returns the build as a line: version, architecture, operating system.
    pub fn build(&self) -> String {
        let checked = if self.debug_assertions { ", with debug assertions" } else { "" };
        format!("palpate {} for {} on {}{checked}", self.palpate, self.architecture, self.os)
    }

    /// Returns the processor as a line.
    pub fn processor_line(&self) -> String {
        let model = self.processor.as_deref().unwrap_or("unknown model");
        match self.processors {
            Some(1) => format!("{model}, 1 processor"),
            Some(count) => format!("{model}, {count} processors"),
            None => model.to_owned(),
        }
    }
}

/// Returns the model from the text of `/proc/cpuinfo`. x86 names a model; ARM names a board, or nothing.
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
    fn model_is_read_from_cpuinfo() {
        let x86 = "processor\t: 0\nmodel\t\t: 85\nmodel name\t: Some Processor @ 2.50GHz\nprocessor\t: 1\n";
        assert_eq!(model_name(x86).as_deref(), Some("Some Processor @ 2.50GHz"));
        let board = "processor\t: 0\nBogoMIPS\t: 108.00\n\nModel\t\t: Some Board Rev 1.4\n";
        assert_eq!(model_name(board).as_deref(), Some("Some Board Rev 1.4"));
        assert_eq!(model_name("processor: 0\nmodel name:\n"), None);
        assert_eq!(model_name(""), None);
    }

    #[test]
    fn lines_contain_the_known_values() {
        let machine = Machine { processor: None, processors: Some(1), ..Machine::this() };
        assert_eq!(machine.processor_line(), "unknown model, 1 processor");
        assert!(machine.build().contains(env!("CARGO_PKG_VERSION")));
    }
}
