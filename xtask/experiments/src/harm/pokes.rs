//! Pokes: tips, pips, blades, edges and corners that go at a flat slab, for a few contact intervals each, and
//! a search for the pose, phase of the queries, speed, rate and shape that goes deepest.
//!
//! The depth is exact without any query: how far the probe's corners are within the slab.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use palpate::device::Emulation;
use palpate::glam::{DQuat, DVec2, DVec3};
use palpate::{HandlePlacement, Object, Pose, Scene, Settings};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::genome::{Genome, mixed};
use super::search::{Column, Trial};
use super::session::{Ended, Outcome};
use super::solids::{Solid, Tessellation, rectangle};
use crate::stability::port::driven::{Driven, PERIOD};

/// Largest depth below the slab's plane, m.
const MAX_DEPTH: f64 = 2e-5;
/// Number of probes, each with a slab of its own: as many as pokes share, since making the fields takes far
/// longer than a poke.
const SHAPES: usize = 72;
/// Time in which the hand comes to its speed, s.
const STARTING: f64 = 0.02;

/// A probe with its point at z = 0 and its body above, and a slab below z = 0.
struct Shape {
    name: String,
    corners: Vec<DVec3>,
    probe: Object,
    slab: Object,
    /// Half the sides of the slab, m.
    half: DVec3,
}

impl Shape {
    fn get(index: usize) -> &'static Result<Self, String> {
        static MADE: [OnceLock<Result<Shape, String>>; SHAPES] = [const { OnceLock::new() }; SHAPES];
        MADE[index].get_or_init(|| {
            // In threads of their own: all of rayon's, in which pokes run, may be waiting here.
            let make = || {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
                pool.map_err(|error| error.to_string())?.install(|| Self::make(index))
            };
            std::thread::scope(|scope| scope.spawn(make).join()).unwrap_or(Err("panicked".to_owned()))
        })
    }

    fn make(index: usize) -> Result<Self, String> {
        let mut rng = StdRng::seed_from_u64(mixed(index as u64));
        let (name, solid) = tip(index, &mut rng);
        let division = |rng: &mut StdRng, most: usize| Tessellation {
            quarters: [0, 0, 1, 2][rng.random_range(0..4)],
            splits: if rng.random_bool(0.5) { rng.random_range(0..most) } else { 0 },
            evenness: rng.random_range(0.0..1.0),
            margin: rng.random_range(0.02..0.4),
        };
        // Tips of few triangles as often as of many.
        let how = Tessellation { quarters: 0, ..division(&mut rng, 60) };
        let solid = solid.tessellated(&how, &mut rng);
        let radius = solid.radius();
        // Small, as the time to make its field goes with its area.
        let half = (DVec3::new(0.25, 0.2, rng.random_range(0.05..0.2)) * radius).max(DVec3::splat(4e-4));
        let how = division(&mut rng, 400);
        let slab = Solid::block(half, &mut rng).tessellated(&how, &mut rng).mapped(|p| p - DVec3::Z * half.z);
        Ok(Self {
            name: format!("{name}, radius {:.1} mm; slab {how:?}", 1e3 * radius),
            probe: solid.object("tip")?,
            corners: solid.vertices,
            slab: slab.object("slab")?,
            half,
        })
    }
}

/// Returns the probe of an index: its kind, by the index, and its sizes at random.
fn tip(index: usize, rng: &mut StdRng) -> (String, Solid) {
    let log = |rng: &mut StdRng, low: f64, high: f64| low * (high / low).powf(rng.random_range(0.0..1.0));
    let at = DVec2::new;
    // Most are narrow, as fields of wide ones take long to make.
    let length = log(rng, 0.01, 0.05);
    let widest = if rng.random_bool(0.1) { 1.0 } else { 0.2 };
    let plate = length * DVec3::new(1.0, log(rng, 0.05, widest), log(rng, 0.03, 0.15));
    let (width, height) = (0.5 * log(rng, 2e-4, 4e-3), log(rng, 5e-4, 0.02));
    let sides = rng.random_range(3..9);
    // A body that stands on a plate by its base, a little apart from it: both are closed.
    let on_plate = |tip: Solid, height: f64, rng: &mut StdRng| {
        let gap = 1e-4;
        tip.and(&Solid::block(plate, rng).mapped(|point| point + DVec3::Z * (height + gap + plate.z)))
    };
    let (millimetres, size) = (2e3 * width, 1e3 * height);
    match index % 9 {
        0 => {
            let tip = Solid::turned(&[at(0.0, 0.0), at(width, height)], sides.max(6), rng);
            (format!("cone {millimetres:.2} × {size:.1} mm on a plate"), on_plate(tip, height, rng))
        }
        1 => {
            // A cone whose point is a part of a ball.
            let round = log(rng, 5e-5, 2e-3);
            let around = |step: usize| {
                let angle = 0.25 * std::f64::consts::PI * step as f64 / 4.0;
                at(round * angle.sin(), round * (1.0 - angle.cos()))
            };
            let mut profile: Vec<DVec2> = (0..=4).map(around).collect();
            profile[0].x = 0.0;
            let end = profile[4];
            profile.push(end + DVec2::ONE * height);
            let top = profile[5].y;
            let tip = Solid::turned(&profile, 12, rng);
            (format!("tip of a radius of {:.2} mm on a plate", 1e3 * round), on_plate(tip, top, rng))
        }
        2 => {
            // Part of the plate, without a gap: the loops have corners at the same angles.
            let height = 2.0 * width * rng.random_range(0.3..3.0);
            let mut angles: Vec<f64> =
                [[plate.x, plate.y], [-plate.x, plate.y], [-plate.x, -plate.y], [plate.x, -plate.y]]
                    .iter()
                    .map(|[x, y]| y.atan2(*x))
                    .chain((0..4).map(|quarter| {
                        (0.5 + f64::from(quarter)) * 0.5 * std::f64::consts::PI - std::f64::consts::PI
                    }))
                    .collect();
            angles.sort_by(f64::total_cmp);
            angles.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
            let outline = |half: DVec2, z: f64| -> Vec<DVec3> {
                let reach = |angle: &f64| {
                    let out = DVec2::from_angle(*angle);
                    (out * (half.x / out.x.abs()).min(half.y / out.y.abs())).extend(z)
                };
                angles.iter().map(reach).collect()
            };
            let rim = plate.truncate();
            let loops = [
                vec![DVec3::ZERO],
                outline(DVec2::splat(width), height),
                outline(rim, height),
                outline(rim, height + 2.0 * plate.z),
                vec![DVec3::Z * (height + 2.0 * plate.z)],
            ];
            (
                format!("pyramid {millimetres:.2} mm wide, {:.2} mm high, of a plate", 1e3 * height),
                Solid::loft(&loops, rng),
            )
        }
        3 => {
            let height = 2.0 * width * rng.random_range(0.3..3.0);
            let tip = Solid::turned(&[at(0.0, 0.0), at(width, height)], sides.min(5), rng);
            (format!("pip {millimetres:.2} × {:.2} mm on a plate", 1e3 * height), on_plate(tip, height, rng))
        }
        4 => {
            // A blade along y.
            let length = plate.y * rng.random_range(0.05..0.9);
            let section = [at(0.0, 0.0), at(width, height), at(-width, height)];
            let blade = Solid::prism(&section, 2.0 * length, rng).mapped(|p| DVec3::new(p.x, -p.z, p.y));
            (format!("blade {millimetres:.2} × {size:.1} mm on a plate"), on_plate(blade, height, rng))
        }
        5 => {
            let pin = Solid::turned(&[at(width, 0.0), at(width, height)], sides.max(6), rng);
            (format!("pin {millimetres:.2} × {size:.1} mm on a plate"), on_plate(pin, height, rng))
        }
        6 => {
            // A corner or an edge down.
            let block = Solid::block(plate, rng);
            let turn = if rng.random_bool(0.5) {
                DQuat::from_rotation_x(rng.random_range(0.1..1.4))
            } else {
                DQuat::from_euler(
                    palpate::glam::EulerRot::XYZ,
                    rng.random_range(0.2..1.3),
                    rng.random_range(0.2..1.3),
                    0.3,
                )
            };
            let block = block.mapped(|point| turn * point);
            let low = block.bounds().0.z;
            ("block on an edge or a corner".to_owned(), block.mapped(|point| point - DVec3::Z * low))
        }
        7 => {
            // Two teeth, so that surfaces of several convex patches come together between them.
            let (apart, other) = (width * rng.random_range(1.1..6.0), rng.random_range(0.0..1.0) * 2e-4);
            let tooth = |x: f64, low: f64, rng: &mut StdRng| {
                Solid::turned(&[at(0.0, low), at(width, height)], 4, rng)
                    .mapped(move |point| point + DVec3::X * x)
            };
            let both = tooth(0.0, 0.0, rng).and(&tooth(2.0 * apart, other, rng));
            (format!("two teeth {millimetres:.2} × {size:.1} mm on a plate"), on_plate(both, height, rng))
        }
        _ => {
            // A needle alone, or a wedge.
            let length = log(rng, 0.005, 0.05);
            let needle = if rng.random_bool(0.5) {
                Solid::turned(&[at(0.0, 0.0), at(width, length)], sides, rng)
            } else {
                let rim = rectangle(at(width, 0.3 * length)).iter().map(|p| p.extend(length)).collect();
                let foot = rectangle(at(1e-5, 0.2 * length)).iter().map(|p| p.extend(0.0)).collect();
                Solid::loft(&[foot, rim], rng)
            };
            // Bodies in the hand have a radius of a millimetre at least.
            (format!("needle {millimetres:.2} × {:.1} mm", 1e3 * length), needle)
        }
    }
}

/// Poke that a genome encodes.
#[derive(Clone, Copy, Debug)]
struct Poke {
    shape: usize,
    turn: DQuat,
    place: DVec2,
    /// Speed of the hand, m/s, and its direction.
    speed: f64,
    along: DVec3,
    /// Rate of contact queries, Hz.
    rate: f64,
    /// Time before the hand moves (s), and height above the slab at which the hand starts (m).
    rest: f64,
    height: f64,
    /// Time for which the hand goes on below the slab, s.
    pressed: f64,
    read: u16,
}

impl Poke {
    fn of(genome: &Genome) -> Self {
        let mut genes = genome.genes();
        let g = &mut genes;
        let shape = (g.unit() * SHAPES as f64) as usize;
        let (speed, rate) = (g.log(0.1, 2.0), g.log(30.0, 1000.0));
        let (yaw, tilt, axis) = (g.range(0.0, TAU), g.log(1e-4, 0.3), g.range(0.0, TAU));
        let is_upright = g.chance(0.4);
        let tilt =
            DQuat::from_axis_angle(DVec2::from_angle(axis).extend(0.0), if is_upright { 0.0 } else { tilt });
        let (slant, towards) = (g.maybe(0.3, |g| g.range(0.0, 0.7)).unwrap_or(0.0), g.range(0.0, TAU));
        let along = DVec2::from_angle(towards).extend(0.0) * slant.sin() - DVec3::Z * slant.cos();
        let place = DVec2::new(g.range(-1.0, 1.0), g.range(-1.0, 1.0));
        // Motion in up to some intervals, so that the surface is reached in any phase of the queries.
        let intervals = g.range(0.0, 3.0);
        let (near, rest) = (g.log(2e-5, 5e-3), g.maybe(0.8, |g| g.range(0.0, 3.0)).unwrap_or(0.0));
        let pressed = (3.0 / rate).max(0.03);
        Self {
            shape,
            turn: tilt * DQuat::from_rotation_z(yaw),
            place,
            speed,
            along,
            rate,
            rest: rest / rate,
            height: near + intervals * speed / rate,
            pressed,
            read: genes.read(),
        }
    }

    fn run(&self, settings: Settings) -> Result<Ended, String> {
        let shape = Shape::get(self.shape).as_ref().map_err(Clone::clone)?;
        let specification = Emulation::default().specification;
        let lowest = shape.corners.iter().map(|corner| (self.turn * *corner).z).fold(f64::INFINITY, f64::min);
        let at = (self.place * shape.half.truncate() * 0.6).extend(self.height - lowest);
        // A slanted poke reaches the slab above its place, wherever it starts.
        let back = self.along * (self.height / self.along.z);
        let start = Pose::new(at + DVec3::new(back.x, back.y, 0.0), self.turn);
        let scene = Scene::new().with(shape.slab.clone(), Pose::IDENTITY);
        let placement = HandlePlacement::new(&settings, &shape.probe, &specification);
        let (mut session, _) =
            Driven::start((&shape.probe, &scene), &specification, settings, self.rate, &start)?;
        let starts = 0.5 * STARTING * self.speed;
        let length = -self.height / self.along.z;
        let time = self.rest + STARTING.max((length + starts) / self.speed) + self.pressed;
        let (mut deepest, mut when) = (0.0_f64, 0.0);
        let (mut touched, mut finite) = (false, true);
        let steps = (time / PERIOD).ceil() as u64;
        for step in 1..=steps {
            let now = step as f64 * PERIOD;
            let moving = (now - self.rest).max(0.0);
            let gone = if moving < STARTING {
                0.5 * self.speed * moving * moving / STARTING
            } else {
                self.speed * moving - starts
            };
            // No further than the coupling's peak force needs.
            let gone = gone.min(length + 0.04);
            let pose = Pose::new(start.translation + self.along * gone, start.rotation);
            let record = session.advance(&placement.device_pose(&pose));
            touched |= record.contact.force != DVec3::ZERO;
            finite &= record.object.is_valid() && record.contact.is_finite() && record.coupling.is_finite();
            let corners = shape.corners.iter().map(|corner| record.object.transform_point(*corner));
            // Beside the slab and below it nothing holds them, and at its sides they are in it by how far
            // they are within.
            let middle = DVec3::Z * -shape.half.z;
            let within = |corner: DVec3| (shape.half - (corner - middle).abs()).min_element();
            let depth = corners.map(within).fold(f64::NEG_INFINITY, f64::max);
            if depth > deepest {
                (deepest, when) = (depth, now);
            }
        }
        let part = if finite { deepest / MAX_DEPTH } else { f64::INFINITY };
        Ok(Ended {
            parts: vec![part],
            harm: part > 1.0,
            steps,
            read: self.read,
            touched,
            note: format!("{:.4} mm at {when:.3} s; {}; {self:?}", 1e3 * deepest, shape.name),
            ..Ended::default()
        })
    }
}

/// Index of a poke's probe; each ninth is of the same kind.
#[cfg(test)]
pub fn shape_of(genome: &Genome) -> usize {
    Poke::of(genome).shape
}

/// Random pokes.
pub struct Pokes;

impl Trial for Pokes {
    fn columns(&self) -> Vec<Column> {
        vec![Column { name: "depth".to_owned(), is_promised: true, is_sought: true }]
    }

    fn run(&self, genome: &Genome) -> Outcome {
        Outcome::caught(|| Poke::of(genome).run(Settings::default()))
    }
}

#[cfg(test)]
mod tests {
    use palpate::settings::ContactSettings;

    use super::*;

    #[test]
    fn tips_are_closed_and_point_at_the_slab() {
        for index in 0..SHAPES {
            let (name, solid) = tip(index, &mut StdRng::seed_from_u64(mixed(index as u64)));
            let report = solid.mesh().expect("a mesh").validate();
            assert!(report.is_solid(), "{index}, {name}: {report:?}");
            assert_eq!(solid.bounds().0.z, 0.0, "{index}, {name}");
        }
    }

    /// Penalties let a probe in: the depth is seen. A poke is the same each time.
    #[test]
    fn a_poke_that_goes_in_is_found() {
        // A shape whose fields take little time.
        let pokes = (0..).map(Genome::new).filter(|genome| Poke::of(genome).shape == 3);
        let soft = Settings { contact: ContactSettings::penalties(200.0), ..Settings::default() };
        let depths: Vec<f64> = pokes
            .take(4)
            .map(|genome| {
                let poke = Poke::of(&genome);
                let [one, two] = [(); 2].map(|()| poke.run(soft).expect("a session"));
                assert_eq!(one, two, "{genome}");
                one.parts[0]
            })
            .collect();
        assert!(depths.iter().any(|part| *part > 5.0), "{depths:?}");
    }
}
