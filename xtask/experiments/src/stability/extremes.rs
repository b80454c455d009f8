//! Map of a light body between teeth, and of scans, at the extremes of mass and contact rate: how deep they
//! go by exact queries, and how much the hand feels of their chatter.

use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, DetailSettings, SearchSettings, ToolSettings,
};
use palpate::{Object, Pose, Scene, Settings};

use self::session::{Case, DEPTH, FREE, Hands, Measured, REST, SLIDING, worst};
use super::grid::{Plan, pairs};
use super::page::{Section, Table, Verdict, row};

mod scans;
pub mod session;

/// Held jaw and fixed one, and how many triangles they have in quick maps.
const JAWS: [&str; 2] = ["upper-jaw", "lower-jaw"];
const QUICK_TRIANGLES: usize = 4000;
/// Mass of the held jaw, kg, and stiffness of its contacts and of the coupling, N/m.
const MASS: f64 = 0.01;
const CONTACT_STIFFNESS: f64 = 5000.0;
const COUPLING_STIFFNESS: f64 = 500.0;

/// Contacts between the jaws.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contacts {
    /// Penalty contacts by levels of detail, with details up to a share of the held jaw's bounding radius
    /// left out.
    Penalties(f64),
    /// The default, which is judged.
    Constraints,
}

impl Contacts {
    fn name(self) -> String {
        match self {
            Self::Penalties(0.0) => "penalties".to_owned(),
            Self::Penalties(error) => format!("penalties, s0 {} %", 100.0 * error),
            Self::Constraints => "constraints".to_owned(),
        }
    }

    /// A session of a light jaw on another, with contacts found at a rate (Hz).
    pub fn case<'a>(self, probe: &'a Object, scene: &'a Scene, contact_rate: f64) -> Case<'a> {
        Case { probe, scene, settings: self.settings(probe.bounding_radius()), contact_rate }
    }

    fn settings(self, radius: f64) -> Settings {
        let penalties = ContactSettings::penalties(CONTACT_STIFFNESS);
        let (contact, method, error) = match self {
            Self::Penalties(error) => (penalties, ContactSearch::Levels, error * radius),
            Self::Constraints => (ContactSettings::default(), ContactSearch::Automatic, 0.0),
        };
        Settings {
            tool: ToolSettings { mass: MASS, ..ToolSettings::default() },
            contact,
            coupling: CouplingSettings { stiffness: Some(COUPLING_STIFFNESS), ..CouplingSettings::default() },
            search: SearchSettings { method, ..SearchSettings::default() },
            detail: DetailSettings { error, ..DetailSettings::default() },
            ..Settings::default()
        }
    }
}

/// Sessions of the jaws with contacts found at a rate: one that explores, and one that presses and holds.
struct Jaws {
    contacts: Contacts,
    rate: f64,
    exploring: Measured,
    pressing: Measured,
}

/// Makes the map.
///
/// # Errors
/// If a model cannot be built, or a session cannot start.
pub fn map(plan: &Plan) -> Result<Section, String> {
    let contacts = plan.choose(
        &[Contacts::Penalties(0.025), Contacts::Penalties(0.0), Contacts::Constraints],
        &[Contacts::Constraints],
    );
    let rates = plan.choose(&[500.0, 100.0, 50.0], &[50.0]);
    let jaws = if plan.scans.is_empty() { jaws(plan, &pairs(&contacts, &rates))? } else { Vec::new() };
    let scans = scans::map(plan)?;
    let of = |wanted: &dyn Fn(&Contacts) -> bool| jaws.iter().filter(|jaws| wanted(&jaws.contacts)).collect();
    let judged: Vec<&Jaws> = of(&|contacts| *contacts == Contacts::Constraints);
    let penalties: Vec<&Jaws> = of(&|contacts| *contacts != Contacts::Constraints);
    let verdicts = if judged.is_empty() { Vec::new() } else { verdicts(&judged) };
    let verdicts = verdicts.into_iter().chain(control(&penalties));
    Ok(Section {
        title: "Extremes: a light jaw on teeth, and scans",
        paragraphs: [vec![introduction()], scans.paragraphs].concat(),
        pictures: scans.pictures,
        tables: [vec![table(&jaws)], scans.tables].concat(),
        verdicts: verdicts.chain(scans.verdicts).collect(),
    })
}

fn introduction() -> String {
    format!(
        "`palpate run {} {} --device emulated --lockstep --contact-rate HZ --seconds 5 --mass {MASS} \
         --contact-stiffness {CONTACT_STIFFNESS} --coupling-stiffness {COUPLING_STIFFNESS}`, the same with `--response \
         penalty --error 0` and `--response penalty --error 2.5%`, and all with a hand that presses and holds \
         (`--device emulated:premium-1.5,task=press --seconds 4`), which alone has a time at rest. Penetration is that \
         of `palpate query --exact` along the recorded poses. Forces are at the device, root mean square above 20 Hz \
         (Butterworth, fourth order, forwards and backwards), in free space, within 0.15 s of touch-down or release \
         (onset), in contact at rest, and in sliding. Third octaves from 20 to 500 Hz are given over the level that a \
         hand around a stylus feels (Israr, Choi and Tan, IROS 2006), with the emulated hand's impedance. Bounds: \
         {} mm; {FREE} N in free space, {REST} N at rest, {SLIDING} N in sliding.",
        JAWS[0],
        JAWS[1],
        1e3 * DEPTH,
    )
}

/// Runs the sessions of the jaws.
fn jaws(plan: &Plan, cases: &[(Contacts, f64)]) -> Result<Vec<Jaws>, String> {
    let models = plan.each("extremes: jaws", &JAWS, |name| {
        let name = if plan.quick { format!("{name}@{QUICK_TRIANGLES}") } else { (*name).to_owned() };
        Object::model(&name).map_err(|error| error.to_string())
    })?;
    let [probe, lower] = &models[..] else { return Err("two jaws are needed".to_owned()) };
    let scene = Scene::new().with(lower.clone(), Pose::IDENTITY);
    let sessions = pairs(cases, &[Hands::Exploring, Hands::Pressing]);
    let found = plan.each("extremes", &sessions, |((contacts, rate), hands)| {
        contacts.case(probe, &scene, *rate).measure(*hands)
    })?;
    let mut found = found.into_iter();
    let paired = cases.iter().map_while(|&(contacts, rate)| {
        Some(Jaws { contacts, rate, exploring: found.next()?, pressing: found.next()? })
    });
    Ok(paired.collect())
}

fn table(jaws: &[Jaws]) -> Table {
    let columns = vec![
        "contacts",
        "contact_rate_hz",
        "told_m",
        "exact_m",
        "exact_at_s",
        "deeper_share",
        "free_n",
        "onset_n",
        "sliding_n",
        "sliding_nm",
        "sliding_s",
        "sliding_band_hz",
        "sliding_ratio",
        "press_told_m",
        "press_exact_m",
        "rest_n",
        "rest_nm",
        "rest_s",
        "rest_band_hz",
        "rest_ratio",
    ];
    let rows = jaws.iter().map(|Jaws { contacts, rate, exploring, pressing }| {
        let (slid, rested) = (&exploring.vibration.sliding, &pressing.vibration.rest);
        let [slid_worst, rested_worst] = [slid, rested].map(worst);
        row![
            contacts.name(),
            rate,
            exploring.told,
            exploring.exact.depth,
            exploring.exact.index.map_or(f64::NAN, |index| 1e-3 * (index + 1) as f64),
            exploring.beyond(),
            exploring.vibration.free.force,
            exploring.vibration.onset.force,
            slid.force,
            slid.torque,
            slid.seconds,
            slid_worst[0],
            slid_worst[1],
            pressing.told,
            pressing.exact.depth,
            rested.force,
            rested.torque,
            rested.seconds,
            rested_worst[0],
            rested_worst[1],
        ]
    });
    Table { name: "extremes".to_owned(), columns, rows: rows.collect() }
}

/// Deepest penetration of both sessions, m.
fn deepest(jaws: &&Jaws) -> f64 {
    jaws.exploring.exact.depth.max(jaws.pressing.exact.depth)
}

/// Negative control: the bound on penetration does not hold of itself.
fn control(penalties: &[&Jaws]) -> Option<Verdict> {
    let depth = penalties.iter().map(deepest).fold(0.0, f64::max);
    (!penalties.is_empty()).then(|| {
        let expected = format!("jaws, penalties penetrate deeper than {} mm", 1e3 * DEPTH);
        Verdict::new(expected, depth > DEPTH, format!("{:.3} mm", 1e3 * depth))
    })
}

/// Returns the verdicts on the sessions with constraints.
fn verdicts(jaws: &[&Jaws]) -> Vec<Verdict> {
    let free = |jaws: &&Jaws| jaws.exploring.vibration.free.force;
    let rest = |jaws: &&Jaws| jaws.pressing.vibration.rest.force;
    let slid = |jaws: &&Jaws| jaws.exploring.vibration.sliding.force;
    let at = |value: &dyn Fn(&&Jaws) -> f64| {
        let each = jaws.iter().map(|jaws| format!("{:.4} at {} Hz", value(jaws), jaws.rate));
        each.collect::<Vec<_>>().join(", ")
    };
    let most = |value: &dyn Fn(&&Jaws) -> f64| jaws.iter().map(value).fold(0.0, f64::max);
    let happened = |seconds: &dyn Fn(&&Jaws) -> f64| jaws.iter().all(|jaws| seconds(jaws) > 0.0);
    let rested = happened(&|jaws| jaws.pressing.vibration.rest.seconds);
    let touched = happened(&|jaws| jaws.exploring.vibration.sliding.seconds);
    vec![
        Verdict::new(
            format!("jaws, constraints: penetration stays within {} mm", 1e3 * DEPTH),
            most(&deepest) <= DEPTH && touched,
            format!("{} mm", at(&|jaws| 1e3 * deepest(jaws))),
        ),
        Verdict::new(
            format!("jaws, constraints: force above 20 Hz stays within {SLIDING} N in sliding"),
            most(&slid) <= SLIDING && touched,
            format!("{} N", at(&slid)),
        ),
        Verdict::new(
            format!("jaws, constraints: force above 20 Hz stays within {REST} N at rest"),
            most(&rest) <= REST && rested,
            format!("{} N", at(&rest)),
        ),
        Verdict::new(
            format!("jaws, constraints: force above 20 Hz stays within {FREE} N in free space"),
            most(&free) <= FREE,
            format!("{} N", at(&free)),
        ),
    ]
}
