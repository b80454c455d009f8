//! All outcomes with their plots as one self-contained HTML document.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use super::outcome::Outcome;

/// Writes the document, of all outcomes that runs have left in a folder, into that folder, and returns its
/// path.
///
/// # Errors
/// If a file cannot be read or written.
pub fn write(folder: &Path) -> Result<PathBuf, String> {
    let (mut kept, mut missing) = (Vec::new(), Vec::new());
    for name in super::names() {
        match Outcome::read(folder, &name)? {
            Some(outcome) => kept.push(outcome),
            None => missing.push(name),
        }
    }
    let plot = |outcome: &Outcome| {
        std::fs::read_to_string(folder.join(format!("{}.svg", outcome.name))).unwrap_or_default()
    };
    let plots: Vec<String> = kept.iter().map(plot).collect();
    let trade = crate::trade::section(folder)?.unwrap_or_default();
    let page = folder.join("index.html");
    std::fs::write(&page, html(&kept, &plots, &missing, &trade))
        .map_err(|error| format!("cannot write {}: {error}", page.display()))?;
    Ok(page)
}

/// Returns the document: outcomes in order with their plots (SVG), the section on speed against accuracy, and
/// the machine.
fn html(outcomes: &[Outcome], plots: &[String], missing: &[String], trade: &str) -> String {
    let (mut rows, mut sections) = (String::new(), String::new());
    for (outcome, plot) in outcomes.iter().zip(plots) {
        let Outcome { name, claim, measured, condition, verdict, seconds } = outcome;
        let [claim, measured, condition] = [claim, measured, condition].map(|text| escaped(text));
        let class = if *verdict == "holds" { "holds" } else { "short" };
        let _ = writeln!(
            rows,
            "<tr><td><a href=\"#{name}\">{name}</a></td><td class=\"{class}\">{verdict}</td><td>{claim}</td><td>{seconds:.1} s</td></tr>"
        );
        let _ = writeln!(
            sections,
            "<section id=\"{name}\"><h2>{name}: <span class=\"{class}\">{verdict}</span></h2><dl><dt>Claim</dt><dd>{claim}</dd>\
             <dt>Condition</dt><dd>{condition}</dd><dt>Measured</dt><dd>{measured}</dd><dt>Command</dt>\
             <dd><code>cargo xtask reproduce {name}</code></dd></dl>{plot}</section>"
        );
    }
    let missing = match missing {
        [] => String::new(),
        names => format!(
            "<p>Not here, for want of their files or because they were not run: {}.</p>\n",
            names.join(", ")
        ),
    };
    let machine = escaped(&machine());
    let held = outcomes.iter().filter(|outcome| outcome.verdict == "holds").count();
    format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>palpate: the dissertation, repeated</title>\n<style>\
         body{{font:15px/1.45 sans-serif;max-width:72em;margin:2em auto;padding:0 1em;color:#1c2733}}\
         table{{border-collapse:collapse}}th{{text-align:left;padding-right:.8em}}td{{border-top:1px solid #d5dde5;padding:.3em .8em .3em 0;vertical-align:top}}\
         dt{{font-weight:bold}}dd{{margin:0 0 .5em}}.holds{{color:#1a7f37}}.short{{color:#b35900}}svg{{max-width:100%;height:auto}}\
         </style>\n<h1>The dissertation, repeated</h1>\n\
         <p>M. A. Otaduy, <em>6-DoF Haptic Rendering Using Contact Levels of Detail and Haptic Textures</em>, 2004. {held} of {} claims \
         hold. Every verdict is computed from the condition beside it. Machine: {machine}. Values lie beside this page as CSV. Nothing \
         in them is random, so that there are no seeds: emulated hands and simulated clocks do the same each time. Those of behaviour are \
         equal, times are not.</p>\n<table>{rows}</table>\n{missing}{sections}{trade}</html>\n",
        outcomes.len()
    )
}

/// Describes processor, number of threads, and system.
fn machine() -> String {
    let described = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = described.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let model = model.map_or("a processor that is not named", |(_, model)| model.trim());
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let build = if cfg!(debug_assertions) { "debug assertions on" } else { "release" };
    format!("{model}, {threads} threads, {} {}, {build}", std::env::consts::OS, std::env::consts::ARCH)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::outcome::Finding;

    #[test]
    fn every_outcome_is_on_the_page_with_its_plot() {
        let outcome = |name: &str, holds| {
            let finding =
                Finding { claim: format!("{name} < 1"), measured: "2".into(), condition: "so".into(), holds };
            Outcome::new(name.to_owned(), finding, 1.0)
        };
        let plots = ["<svg>one</svg>".to_owned(), "<svg>two</svg>".to_owned()];
        let page = html(
            &[outcome("fig-1", true), outcome("fig-2", false)],
            &plots,
            &["fig-3".to_owned()],
            "<p>trade</p>",
        );
        for said in [
            "id=\"fig-1\"",
            "fig-2 &lt; 1",
            "<svg>one</svg>",
            "<svg>two</svg>",
            "1 of 2 claims",
            "falls short",
            "cargo xtask reproduce fig-2",
            "<p>trade</p>",
            "were not run: fig-3.",
        ] {
            assert!(page.contains(said), "{said}\n{page}");
        }
        // The document loads nothing from elsewhere.
        assert!(!page.contains("src=") && !page.contains("http"), "{page}");
    }
}
