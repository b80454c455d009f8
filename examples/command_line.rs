//! The command lines of the examples.

use std::error::Error;
use std::fmt::Display;
use std::io::{Write as _, stdout};
use std::path::PathBuf;
use std::str::FromStr;

/// Command line of an example.
#[derive(Debug)]
pub struct CommandLine(pico_args::Arguments);

impl CommandLine {
    /// Parses the command line. With `--help`, prints what the example does and its options, one per line,
    /// and exits.
    #[must_use]
    pub fn new(about: &str, options: &[&str]) -> Self {
        let mut arguments = pico_args::Arguments::from_env();
        if arguments.contains(["-h", "--help"]) {
            let options: String = options.iter().map(|option| format!("  {option}\n")).collect();
            // An error means that nobody can read the output.
            let _ = write!(stdout(), "{about}\n\nOptions:\n{options}  --help\n");
            std::process::exit(0);
        }
        Self(arguments)
    }

    /// Returns whether an option without a value is given.
    pub fn flag(&mut self, name: &'static str) -> bool {
        self.0.contains(name)
    }

    /// Returns an option's value, or its default.
    ///
    /// # Errors
    /// If the value is missing or cannot be parsed.
    pub fn value<T>(&mut self, name: &'static str, default: T) -> Result<T, Box<dyn Error>>
    where
        T: FromStr<Err: Display>,
    {
        Ok(self.0.opt_value_from_str(name)?.unwrap_or(default))
    }

    /// Returns the length of a session, s.
    ///
    /// # Errors
    /// If it is not above 0 and at most an hour.
    pub fn seconds(&mut self, default: f64) -> Result<f64, Box<dyn Error>> {
        let seconds = self.value("--seconds", default)?;
        let within = seconds > 0.0 && seconds <= 3600.0;
        within
            .then_some(seconds)
            .ok_or_else(|| format!("--seconds {seconds}: give more than 0, at most 3600").into())
    }

    /// Returns the arguments that are not options.
    ///
    /// # Errors
    /// If there is an option that the example does not have.
    pub fn others(self) -> Result<Vec<String>, Box<dyn Error>> {
        let others: Vec<String> =
            self.0.finish().into_iter().map(|word| word.to_string_lossy().into_owned()).collect();
        match others.iter().find(|word| word.starts_with('-')) {
            None => Ok(others),
            Some(option) => Err(format!("there is no option {option}: see --help").into()),
        }
    }

    /// Ends a command line that has only options.
    ///
    /// # Errors
    /// If an argument remains.
    pub fn finish(self) -> Result<(), Box<dyn Error>> {
        match self.others()?.first() {
            None => Ok(()),
            Some(word) => Err(format!("'{word}' is not expected: see --help").into()),
        }
    }
}

/// Options of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Whether to run on a simulated clock.
    pub lockstep: bool,
    /// Length of the session, s.
    pub seconds: f64,
    /// Folder for the recording and the report; `target/NAME` by default.
    pub output: Option<PathBuf>,
}

impl Options {
    /// Lines of these options in `--help`.
    pub const HELP: [&str; 3] = [
        "--lockstep     Run on a simulated clock in one thread: the result is reproducible",
        "--seconds S    Render for so long, at most an hour [default: 10]",
        "--output DIR   Write the recording and the report there [default: target/NAME]",
    ];

    /// Parses a command line without other options.
    ///
    /// # Errors
    /// If an option cannot be parsed, or there are others.
    pub fn parse(about: &str) -> Result<Self, Box<dyn Error>> {
        let mut line = CommandLine::new(about, &Self::HELP);
        let options = Self::take(&mut line)?;
        line.finish()?;
        Ok(options)
    }

    /// Takes the options from a command line.
    ///
    /// # Errors
    /// If an option cannot be parsed.
    pub fn take(line: &mut CommandLine) -> Result<Self, Box<dyn Error>> {
        let output: String = line.value("--output", String::new())?;
        Ok(Self {
            lockstep: line.flag("--lockstep"),
            seconds: line.seconds(10.0)?,
            output: (!output.is_empty()).then(|| output.into()),
        })
    }
}
