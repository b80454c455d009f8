//! Variations of one setting at a time.

use palpate::Settings;
use palpate::dynamics::{IntegratorKind, MAX_CLUSTERS};
use palpate::settings::{ContactSearch, DetailSettings, SearchSettings, TextureBackend, TimingSettings};

use super::scenario::Scenario;

/// Change of one setting.
#[derive(Clone, Debug, PartialEq)]
pub struct Variation {
    /// Setting that is changed.
    pub axis: Axis,
    /// Its value.
    pub value: String,
    pub settings: Settings,
    pub integrator: IntegratorKind,
}

/// Setting that is varied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Error threshold s₀, relative to the probe's bounding radius.
    Error,
    /// Error threshold s₀ with forces that jump between levels of detail.
    ErrorWithoutInterpolation,
    /// EPS of representative contacts, relative to the probe's bounding radius; the first is the smallest.
    Representatives,
    /// Time limit of queries, with s₀ the smallest above 0.
    QueryBudget,
    Clusters,
    TextureGrid,
    Precision,
    Integrator,
    HapticRate,
}

impl Variation {
    /// Returns whether instruction counts are meaningful: callgrind slows down work with a time limit, and
    /// does not see a GPU's work.
    pub fn is_counted(&self) -> bool {
        self.axis.is_reproducible() && self.settings.textures.backend != TextureBackend::Gpu
    }
}

impl Axis {
    pub const ALL: [Self; 9] = [
        Self::Error,
        Self::ErrorWithoutInterpolation,
        Self::Representatives,
        Self::QueryBudget,
        Self::Clusters,
        Self::TextureGrid,
        Self::Precision,
        Self::Integrator,
        Self::HapticRate,
    ];

    pub fn word(self) -> &'static str {
        match self {
            Self::Error => "s0",
            Self::ErrorWithoutInterpolation => "s0, not interpolated",
            Self::Representatives => "representatives, EPS",
            Self::QueryBudget => "query limit",
            Self::Clusters => "clusters",
            Self::TextureGrid => "grid",
            Self::Precision => "precision",
            Self::Integrator => "integrator",
            Self::HapticRate => "haptic rate",
        }
    }

    /// Returns whether the results are reproducible.
    pub fn is_reproducible(self) -> bool {
        // A time limit is kept by the clock.
        self != Self::QueryBudget
    }
}

/// Thresholds s₀ relative to the probe's bounding radius, and the usual one (§3.5.2), at which settings other
/// than detail are varied.
const ERRORS: [f64; 7] = [0.0, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1];
const USUAL_ERROR: f64 = 0.025;
/// EPS of representative contacts, relative to the probe's bounding radius.
const REPRESENTATIVE_ERRORS: [f64; 4] = [0.0002, 0.0005, 0.001, 0.002];
/// Time limits of queries, s.
const BUDGETS: [f64; 4] = [50e-6, 100e-6, 200e-6, 500e-6];
const CLUSTERS: [usize; 6] = [1, 2, 3, 5, 8, MAX_CLUSTERS];
const GRIDS: [u32; 4] = [12, 25, 50, 100];
/// Rates of the haptic loop, Hz.
const RATES: [f64; 4] = [500.0, 1000.0, 2000.0, 4000.0];

/// Returns the variations for a scenario. The first is full resolution.
pub fn variations(scenario: &Scenario) -> Vec<Variation> {
    let radius = scenario.probe.bounding_radius();
    let full = Settings {
        search: SearchSettings { method: ContactSearch::Levels, ..scenario.settings.search },
        ..scenario.settings
    };
    let usual = if scenario.textured {
        full
    } else {
        Settings { detail: DetailSettings { error: USUAL_ERROR * radius, ..full.detail }, ..full }
    };
    let mut all = Vec::new();
    let usual_integrator = IntegratorKind::default();
    let mut add = |axis, value: String, settings| {
        all.push(Variation { axis, value, settings, integrator: usual_integrator });
    };
    if scenario.textured {
        for grid in GRIDS.into_iter().rev() {
            let mut settings = full;
            settings.textures.grid = grid;
            add(Axis::TextureGrid, format!("{grid} x {grid}"), settings);
        }
        let mut gpu = full;
        gpu.textures.backend = TextureBackend::Gpu;
        add(Axis::Precision, "f64, processor".to_owned(), full);
        add(Axis::Precision, "f32, wgpu".to_owned(), gpu);
    } else {
        let percent = |error: f64| format!("{} %", 100.0 * error);
        for error in ERRORS {
            add(
                Axis::Error,
                percent(error),
                Settings { detail: DetailSettings { error: error * radius, ..full.detail }, ..full },
            );
        }
        for error in ERRORS.into_iter().skip(1) {
            let settings = Settings {
                detail: DetailSettings { error: error * radius, interpolation: false, ..full.detail },
                ..full
            };
            add(Axis::ErrorWithoutInterpolation, percent(error), settings);
        }
        if scenario.is_closed() {
            for error in REPRESENTATIVE_ERRORS {
                let representative_error = Some(error * radius);
                let search = ContactSearch::Representatives;
                add(
                    Axis::Representatives,
                    percent(error),
                    Settings {
                        search: SearchSettings { method: search, representative_error, ..full.search },
                        ..full
                    },
                );
            }
        }
        for budget in BUDGETS {
            let settings = Settings {
                detail: DetailSettings {
                    error: ERRORS[1] * radius,
                    query_budget: Some(budget),
                    ..full.detail
                },
                ..full
            };
            add(Axis::QueryBudget, format!("{:.0} us", 1e6 * budget), settings);
        }
    }
    for clusters in CLUSTERS {
        add(
            Axis::Clusters,
            clusters.to_string(),
            Settings { search: SearchSettings { clusters, ..usual.search }, ..usual },
        );
    }
    for rate in RATES {
        add(
            Axis::HapticRate,
            format!("{rate} Hz"),
            Settings { timing: TimingSettings { rate, ..usual.timing }, ..usual },
        );
    }
    all.extend(IntegratorKind::ALL.map(|integrator| Variation {
        axis: Axis::Integrator,
        value: integrator.to_string(),
        settings: usual,
        integrator,
    }));
    all
}
