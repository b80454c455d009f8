//! The command lines of the examples.

use std::error::Error;
use std::fmt::Display;
use std::io::{Write as _, stdout};
use std::path::PathBuf;
use std::str::FromStr;

/// An example's command line.
#[derive(Debug)]
pub struct CommandLine(pico_args::Arguments);

impl CommandLine {
    /// With `--help`, prints what the example does and its options, a line each, and ends the program.
    #[must_use]
    pub fn new(about: &str, options: &[&str]) -> Self {
        let mut arguments = pico_args::Arguments::from_env();
        if arguments.contains(["-h", "--help"]) {
            let options: String = options.iter().map(|option| format!("  {option}\n")).collect();
            // If nobody can read it, so be it.
            let _ = write!(stdout(), "{about}\n\nOptions:\n{options}  --help\n");
            std::process::exit(0);
        }
        Self(arguments)
    }

    /// Whether an option without a value is given.
    pub fn flag(&mut self, name: &'static str) -> bool {
        self.0.contains(name)
    }

    /// An option's value, or what it is where it is not given.
    ///
    /// # Errors
    /// If the value is missing or cannot be understood.
    pub fn value<T>(&mut self, name: &'static str, default: T) -> Result<T, Box<dyn Error>>
    where
        T: FromStr<Err: Display>,
    {
        Ok(self.0.opt_value_from_str(name)?.unwrap_or(default))
    }

    /// The length of a session, s.
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

    /// What is neither an option nor its value.
    ///
    /// # Errors
    /// If an option is left that the example does not have.
    pub fn others(self) -> Result<Vec<String>, Box<dyn Error>> {
        let others: Vec<String> =
            self.0.finish().into_iter().map(|word| word.to_string_lossy().into_owned()).collect();
        match others.iter().find(|word| word.starts_with('-')) {
            None => Ok(others),
            Some(option) => Err(format!("there is no option {option}: see --help").into()),
        }
    }

    /// The end of a command line that has options alone.
    ///
    /// # Errors
    /// If anything is left.
    pub fn finish(self) -> Result<(), Box<dyn Error>> {
        match self.others()?.first() {
            None => Ok(()),
            Some(word) => Err(format!("'{word}' is not expected: see --help").into()),
        }
    }
}

/// What the user may choose about a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Whether to run on a simulated clock.
    pub lockstep: bool,
    /// How long to render, s.
    pub seconds: f64,
    /// Folder for the recording and the report; `target/NAME` where none is given.
    pub output: Option<PathBuf>,
}

impl Options {
    /// Their lines in `--help`.
    pub const HELP: [&str; 3] = [
        "--lockstep     Run on a simulated clock in one thread: the result is the same each time",
        "--seconds S    Render for so long, at most an hour [default: 10]",
        "--output DIR   Write the recording and the report there [default: target/NAME]",
    ];

    /// The options of an example that has no others.
    ///
    /// # Errors
    /// If one cannot be understood, or there are others.
    pub fn parse(about: &str) -> Result<Self, Box<dyn Error>> {
        let mut line = CommandLine::new(about, &Self::HELP);
        let options = Self::take(&mut line)?;
        line.finish()?;
        Ok(options)
    }

    /// Takes them from a command line.
    ///
    /// # Errors
    /// If one cannot be understood.
    pub fn take(line: &mut CommandLine) -> Result<Self, Box<dyn Error>> {
        let output: String = line.value("--output", String::new())?;
        Ok(Self {
            lockstep: line.flag("--lockstep"),
            seconds: line.seconds(10.0)?,
            output: (!output.is_empty()).then(|| output.into()),
        })
    }
}
