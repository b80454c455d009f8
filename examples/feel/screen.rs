//! Display of a session as text.

use palpate::glam::DVec3;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style};
use ratatui::text::Line;
use ratatui::widgets::{Block, Gauge, Paragraph, Sparkline};

use palpate_report::{Extremes, Live, Rates};

/// Draws the display, with a title above and the list of keys below.
pub fn draw(frame: &mut Frame, live: &Live, title: &str, keys: &str) {
    let [head, bars, forces, depths, foot] = Layout::vertical([
        Constraint::Length(4),
        Constraint::Length(6),
        Constraint::Fill(1),
        Constraint::Fill(1),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    frame.render_widget(
        figures(live).block(Block::bordered().title(format!("{title}, by {}", live.device))),
        head,
    );

    let [force, torque] = Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(bars);
    let wrench = live.wrench();
    draw_bars(frame, force, "force", wrench.force, live.peak.0, "N");
    draw_bars(frame, torque, "torque", wrench.torque * 1e3, live.peak.1 * 1e3, "mN·m");

    let most = live.most;
    let columns = |of: &dyn Fn(&Extremes) -> f64| -> Vec<u64> {
        // As many values as there is room for, the latest at the right.
        let room = frame.area().width.saturating_sub(2) as usize;
        let skipped = live.history.len().saturating_sub(room);
        live.history.iter().skip(skipped).map(|extremes| (of(extremes) * 1e6) as u64).collect()
    };
    for (area, name, data, color) in [
        (
            forces,
            format!("force, last 10 s; at most {:.2} N", most.force),
            columns(&|it| it.force),
            Color::Cyan,
        ),
        (
            depths,
            format!("depth, last 10 s; at most {:.3} mm", 1e3 * most.depth),
            columns(&|it| it.depth * 1e3),
            Color::Magenta,
        ),
    ] {
        let line = Sparkline::default().data(data).style(Style::new().fg(color));
        frame.render_widget(line.block(Block::bordered().title(name)), area);
    }
    frame.render_widget(Line::from(keys.to_owned()), foot);
}

/// Formats rates, depth and contacts.
fn figures(live: &Live) -> Paragraph<'static> {
    let Rates { haptic, missed, contact } = live.rates;
    let Some(record) = live.latest else { return Paragraph::new("starting") };
    Paragraph::new(vec![
        Line::from(format!(
            "{:7.2} s   haptic loop {haptic:6.0} Hz, {missed:.0} periods missed a second   contact loop {contact:6.0} Hz",
            record.time
        )),
        Line::from(format!(
            "{:3} contacts   depth {:7.3} mm   contact model {:5.1} ms old",
            record.contacts,
            1e3 * record.depth,
            1e3 * record.model_age
        )),
    ])
}

/// Draws a bar for the magnitude of a vector, and one for each component.
fn draw_bars(frame: &mut Frame, area: Rect, name: &str, vector: DVec3, full: f64, unit: &str) {
    let block = Block::bordered().title(format!("{name}, of {full:.1} {unit}"));
    let rows = Layout::vertical([Constraint::Length(1); 4]).split(block.inner(area));
    frame.render_widget(block, area);
    let parts = [("|·|", vector.length()), ("x", vector.x), ("y", vector.y), ("z", vector.z)];
    for ((label, value), row) in parts.into_iter().zip(rows.iter()) {
        let color = if value.abs() > 0.75 * full { Color::Red } else { Color::Green };
        let share = (value.abs() / full).clamp(0.0, 1.0);
        let gauge = Gauge::default()
            .ratio(if share.is_finite() { share } else { 0.0 })
            .gauge_style(Style::new().fg(color));
        frame.render_widget(gauge.label(format!("{label:3} {value:+8.2}")), *row);
    }
}

#[cfg(test)]
mod tests {
    use palpate::device::Emulation;
    use palpate::{Pose, Record, Wrench};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;

    fn screen(width: u16, height: u16, live: &Live) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, live, "spoon against cup", "q ends")).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn figures_stand_on_the_screen() {
        let mut live = Live::new(&Emulation::default().specification, 1e-3);
        assert!(screen(100, 30, &live).contains("starting"));
        for step in 1..=1000 {
            let record = Record {
                time: f64::from(step) * 1e-3,
                device: Pose::IDENTITY,
                handle: Pose::IDENTITY,
                object: Pose::IDENTITY,
                coupling: Wrench::new(DVec3::new(0.0, -4.25, 0.0), DVec3::X * 0.1),
                contact: Wrench::ZERO,
                depth: 1.5e-4,
                contacts: 7,
                model_age: f64::from(step % 2) * 1e-3,
            };
            live.take(&record);
        }
        let screen = screen(100, 30, &live);
        for said in [
            "spoon against cup",
            "1000 Hz",
            "500 Hz",
            "7 contacts",
            "0.150 mm",
            "-4.25",
            "+100.00",
            "8.5 N",
            "188.0 mN·m",
            "q ends",
            "at most 4.25 N",
        ] {
            assert!(screen.contains(said), "{said}\n{screen}");
        }
    }

    #[test]
    fn it_fits_any_terminal() {
        let live = Live::new(&Emulation::default().specification, 1e-3);
        for (width, height) in [(1, 1), (3, 100), (300, 2), (20, 10)] {
            screen(width, height, &live);
        }
    }
}
