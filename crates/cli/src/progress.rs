//! Progress bars on standard error, if that is a terminal.

use std::ops::ControlFlow;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use palpate::clod_build::Stage;
use palpate::mesh_io::LoadWarning;

/// Resolution of a bar, steps. With fewer, the bar jumps.
const STEPS: u64 = 1000;

/// Shows a bar from 0 to 1 with the name of the work.
pub fn bar(what: &str) -> ProgressBar {
    let bar = ProgressBar::new(STEPS).with_message(what.to_owned());
    if let Ok(style) = ProgressStyle::with_template("{msg:40} {bar:30} {percent:>3} %  {elapsed} + {eta}") {
        bar.set_style(style);
    }
    bar
}

/// Shows a spinner with the name of work of unknown duration.
pub fn waiting(what: &str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner().with_message(what.to_owned());
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}

/// Shows the stages of a build on a bar, with an estimate of the overall progress.
pub fn of_build<'a>(bar: &'a ProgressBar, name: &'a str) -> impl FnMut(Stage, f64) -> ControlFlow<()> + 'a {
    let mut shown = None;
    move |stage, fraction| {
        if shown != Some(stage) {
            bar.set_message(format!("{name}: {stage}"));
            shown = Some(stage);
        }
        set(bar, stage.of_build(fraction));
        ControlFlow::Continue(())
    }
}

/// Opens the models of a file with a bar that shows each model and its stage.
pub fn open_all<R>(
    file: &str,
    open: impl FnOnce(&mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>) -> R,
) -> R {
    let bar = bar(file);
    let opened = open(&mut |model, stage, done| {
        bar.set_message(format!("{model}: {stage}"));
        set(&bar, done);
        ControlFlow::Continue(())
    });
    bar.finish_and_clear();
    opened
}

/// Moves a bar to a fraction from 0 to 1.
pub fn set(bar: &ProgressBar, fraction: f64) {
    bar.set_position((STEPS as f64 * fraction.clamp(0.0, 1.0)) as u64);
}

/// Opens an object with a progress bar, and prints the loader's warnings.
pub fn open(
    argument: &str,
    options: &palpate::OpenOptions,
) -> Result<palpate::Object, palpate::errors::OpenError> {
    let bar = bar(argument);
    let opened = palpate::Object::open(argument, options, &mut of_build(&bar, argument));
    bar.finish_and_clear();
    let object = opened?;
    warn_of_loading(argument, object.warnings());
    Ok(object)
}

/// Text of a loader's warning, with options named as on the command line.
fn in_words(warning: &LoadWarning) -> String {
    match warning {
        LoadWarning::Units { radius, suggested } => {
            let remedy = match suggested {
                Some(scale) => format!("try --scale {scale}"),
                None => "give the metres per unit of the file as --scale".to_owned(),
            };
            format!("the bounding radius of {radius:.3e} m suggests a wrong unit: {remedy}")
        }
        other => other.to_string(),
    }
}

/// Texts of a loader's warnings.
pub fn words(warnings: &[LoadWarning]) -> Vec<String> {
    warnings.iter().map(in_words).collect()
}

/// Prints a loader's warnings about `argument`.
pub fn warn_of_loading(argument: &str, warnings: &[LoadWarning]) {
    warn(argument, &words(warnings));
}

/// Prints warnings about `argument`.
pub fn warn(argument: &str, warnings: &[String]) {
    for warning in warnings {
        crate::complain(format_args!("palpate: {argument}: warning: {warning}"));
    }
}
