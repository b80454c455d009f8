//! A picture of the grasped object and the scene at one time: the whole scene, and a close-up of the object,
//! both from the direction in which most of the object is visible.

use palpate::glam::{DQuat, DVec3};
use palpate::{Object, Pose, Record, Scene, TriMesh};

use crate::patches::Surface;
use crate::picture::Picture;
use crate::plot::PlotError;
use crate::quantity::{force, length, quantity};
use crate::raster::{Camera, Item, Shading, View};

/// Colours of the grasped object and the scene, linear RGB.
const PROBE: [f32; 3] = [0.06, 0.22, 0.60];
const SCENE: [f32; 3] = [0.62, 0.60, 0.55];
/// Size of each of the two pictures, pixels.
const SIZE: (u32, u32) = (480, 360);
/// Size of the trial pictures by which directions are compared, pixels.
const TRIAL_SIZE: (u32, u32) = (80, 60);
/// Azimuths of the compared directions, degrees.
const AZIMUTHS: [f64; 8] = [-60.0, -15.0, 30.0, 75.0, 120.0, 165.0, 210.0, 255.0];
/// Elevations of the compared directions, degrees.
const ELEVATIONS: [f64; 2] = [20.0, 50.0];
/// Size of the close-up's field, in sizes of the object.
const CLOSE_UP_SIZE: f64 = 1.15;

/// Time of a session that the picture shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment<'a> {
    pub record: &'a Record,
    reason: Reason,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Reason {
    Deepest,
    Hardest,
    Last,
}

impl<'a> Moment<'a> {
    /// Returns the time of the deepest penetration; without penetration that of the largest contact force;
    /// without contact the last one.
    pub fn of(records: &'a [Record]) -> Option<Self> {
        let largest = |value: &dyn Fn(&Record) -> f64| {
            let best = records.iter().max_by(|a, b| value(a).total_cmp(&value(b)))?;
            (value(best) > 0.0).then_some(best)
        };
        let deepest = largest(&|record| record.depth).map(|record| Self { record, reason: Reason::Deepest });
        let hardest = || {
            let record = largest(&|record| record.contact.force.length())?;
            Some(Self { record, reason: Reason::Hardest })
        };
        let last = || Some(Self { record: records.last()?, reason: Reason::Last });
        deepest.or_else(hardest).or_else(last)
    }

    /// Returns the caption of the picture.
    pub fn caption(&self, probe: &str) -> String {
        let Self { record, reason } = self;
        let moment = match reason {
            Reason::Deepest => format!("at its deepest penetration of {}", length(record.depth)),
            Reason::Hardest => {
                format!("at the largest contact force of {}", force(record.contact.force.length()))
            }
            Reason::Last => "at the end; nothing was touched".to_owned(),
        };
        format!(
            "{probe} (blue) {moment}, after {}: the whole scene, and a close-up.",
            quantity(record.time, "s")
        )
    }
}

/// Draws the picture and encodes it as a PNG file.
///
/// # Errors
/// If it cannot be encoded.
pub(crate) fn png(probe: &Object, scene: &Scene, pose: &Pose) -> Result<Vec<u8>, PlotError> {
    draw(probe, scene, pose).to_png().map_err(|error| PlotError::new(error.to_string()))
}

fn draw(probe: &Object, scene: &Scene, pose: &Pose) -> Picture {
    let probe = Surface::of(&probe.clod, 0).mesh;
    let objects: Vec<(TriMesh, Pose)> = scene
        .objects()
        .iter()
        .map(|placed| (Surface::of(&placed.object.clod, 0).mesh, placed.pose))
        .collect();
    let mut items: Vec<Item<'_>> = objects.iter().map(|(mesh, pose)| placed(mesh, SCENE, pose)).collect();
    items.push(placed(&probe, PROBE, pose));

    let near: Vec<DVec3> = probe.vertices().iter().map(|vertex| pose.transform_point(*vertex)).collect();
    let near = enlarged(&near);
    let mut all = near.clone();
    for (mesh, pose) in &objects {
        all.extend(mesh.vertices().iter().map(|vertex| pose.transform_point(*vertex)));
    }
    let view = clearest(&items, &near);
    let mut picture = Picture::filled(2 * SIZE.0, SIZE.1, [0; 3]);
    for (column, points) in [(0, &all), (1, &near)] {
        let part = Camera::fit(points, &view, SIZE.0, SIZE.1).render(&items, Shading::Smooth);
        picture.place(&part, column * SIZE.0, 0);
    }
    picture
}

fn placed<'a>(mesh: &'a TriMesh, color: [f32; 3], pose: &Pose) -> Item<'a> {
    let (rotation, translation): (DQuat, DVec3) = (pose.rotation, pose.translation);
    Item { rotation, translation, ..Item::new(mesh, color) }
}

/// Returns the corners of the bounding box of points, enlarged about its centre.
fn enlarged(points: &[DVec3]) -> Vec<DVec3> {
    let ends = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (low, high) = points.iter().fold(ends, |(low, high), point| (low.min(*point), high.max(*point)));
    let (middle, half) = (0.5 * (low + high), 0.5 * CLOSE_UP_SIZE * (high - low));
    let sign = |bit: u8| if bit == 0 { -1.0 } else { 1.0 };
    (0..8_u8)
        .map(|corner| middle + half * DVec3::new(sign(corner & 1), sign(corner & 2), sign(corner & 4)))
        .collect()
}

/// Returns the view in which most of the grasped object is visible.
fn clearest(items: &[Item<'_>], near: &[DVec3]) -> View {
    let views = ELEVATIONS
        .iter()
        .flat_map(|elevation| AZIMUTHS.map(|azimuth| View::from_degrees(azimuth, *elevation)));
    let seen = |view: &View| {
        let picture = Camera::fit(near, view, TRIAL_SIZE.0, TRIAL_SIZE.1).render(items, Shading::Smooth);
        picture.pixels().iter().filter(|pixel| is_probe(**pixel)).count()
    };
    // The first of equal ones, which has the lower elevation.
    let best =
        views.map(|view| (seen(&view), view)).reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map_or(View::from_degrees(AZIMUTHS[0], ELEVATIONS[0]), |(_, view)| view)
}

/// Returns whether a pixel has the grasped object's colour, in any light.
fn is_probe([red, _, blue]: [u8; 3]) -> bool {
    u16::from(blue) > u16::from(red) + 30
}

#[cfg(test)]
mod tests {
    use palpate::Wrench;

    use super::*;

    fn record(time: f64, depth: f64, force: f64) -> Record {
        let pose = Pose::from_translation(DVec3::new(0.0, 0.0, time));
        Record {
            time,
            device: pose,
            handle: pose,
            object: pose,
            coupling: Wrench::ZERO,
            contact: Wrench::new(DVec3::new(0.0, 0.0, force), DVec3::ZERO),
            depth,
            contacts: 0,
            model_age: f64::NAN,
        }
    }

    #[test]
    fn moment_is_that_of_depth_else_force_else_the_last() {
        let shown = |records: &[Record]| {
            Moment::of(records).map(|moment| (moment.record.time, moment.caption("cup")))
        };
        assert_eq!(shown(&[]), None);
        let (time, caption) = shown(&[record(1.0, 0.0, 0.0), record(2.0, 0.0, 0.0)]).unwrap();
        assert!(time == 2.0 && caption.contains("nothing was touched"), "{caption}");
        let (time, caption) = shown(&[record(1.0, 0.0, 2.0), record(2.0, 0.0, 1.0)]).unwrap();
        assert!(time == 1.0 && caption.contains("force of 2.00 N"), "{caption}");
        let (time, caption) =
            shown(&[record(1.0, 0.0, 2.0), record(2.0, 4e-4, 1.0), record(3.0, 1e-4, 9.0)]).unwrap();
        assert!(time == 2.0 && caption.contains("penetration of 0.400 mm"), "{caption}");
    }

    /// The probe is visible although the scene's object hides it from most sides, and the picture is a small
    /// file.
    #[test]
    fn probe_is_visible() {
        let probe = Object::model("ellipsoid@500").expect("model");
        let wall = Object::model("block@300").expect("model");
        let size = wall.bounding_radius();
        let scene = Scene::new().with(wall, Pose::IDENTITY);
        // Behind the block, as seen from the first direction.
        let pose = Pose::from_translation(DVec3::new(-0.6 * size, 1.2 * size, -0.3 * size));
        let picture = draw(&probe, &scene, &pose);
        let count = |columns: std::ops::Range<u32>| {
            let pixels = columns.flat_map(|x| (0..SIZE.1).map(move |y| (x, y)));
            pixels.filter(|(x, y)| is_probe(picture.pixel(*x, *y))).count()
        };
        let (whole, close) = (count(0..SIZE.0), count(SIZE.0..2 * SIZE.0));
        assert!(whole > 50 && close > 10_000 && close > whole, "{whole} and {close} pixels");
        let png = png(&probe, &scene, &pose).expect("PNG");
        assert!(png.len() < 200_000, "{} bytes", png.len());
    }
}
