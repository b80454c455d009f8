//! Colours of the models, and the scenes of the README.

use std::collections::{BTreeSet, HashMap};
use std::error::Error;
use std::f64::consts::TAU;

use glam::{DQuat, DVec3};
use palpate_clod_build::{BuildOptions, build, unwatched};
use palpate_models::{MetricThread, Model};
use palpate_report::raster::{Camera, Item, Shading, View};
use palpate_report::{LevelPictures, Picture, views};

use super::{HEIGHT, WIDTH};

const BONE: [f32; 3] = [0.78, 0.70, 0.52];
const PORCELAIN: [f32; 3] = [0.34, 0.50, 0.66];
const STEEL: [f32; 3] = [0.46, 0.49, 0.54];
const BRASS: [f32; 3] = [0.66, 0.47, 0.19];
const CLAY: [f32; 3] = [0.60, 0.27, 0.17];
const WHITE: [f32; 3] = [0.82, 0.82, 0.80];

/// Opening angle of the jaws in the README's picture, degrees.
const OPENING: f64 = 3.5;

/// Tilt of the peg in its picture, degrees.
const PEG_TILT: f64 = 3.0;

/// Returns a colour (linear RGB, 0 to 1) that suits the model.
pub fn color(model: Model) -> [f32; 3] {
    match model {
        Model::LowerJaw | Model::UpperJaw => BONE,
        Model::Cup | Model::CupLow => PORCELAIN,
        Model::GolfBall => WHITE,
        Model::BallJointBall | Model::Gear => BRASS,
        Model::Torus | Model::Block | Model::Ellipsoid => CLAY,
        Model::BallJointSocket
        | Model::GolfClub
        | Model::Spoon
        | Model::SpoonLow
        | Model::Hammer
        | Model::CadPart
        | Model::File
        | Model::Stylus
        | Model::Plate
        | Model::ForcepsJaw
        | Model::Bolt
        | Model::Nut
        | Model::Peg
        | Model::Hole => STEEL,
    }
}

/// Draws the picture at the head of the README: the lower jaw, slightly open, touches the upper.
pub fn touching_jaws() -> Result<Picture, Box<dyn Error>> {
    let lower = Model::LowerJaw.generate(Model::LowerJaw.default_triangles())?;
    let upper = Model::UpperJaw.generate(Model::UpperJaw.default_triangles())?;
    // In their common frame, in which they are closed, z is up and y forward.
    let rotation = DQuat::from_rotation_x(-OPENING.to_radians());
    let opened: Vec<DVec3> = lower.vertices().iter().map(|vertex| rotation * *vertex).collect();
    let lift = clearance(&opened, upper.vertices());
    let items = [
        Item { rotation, translation: lift * DVec3::Z, ..Item::new(&lower, BONE) },
        Item::new(&upper, PORCELAIN),
    ];
    let points =
        opened.iter().map(|point| *point + items[0].translation).chain(upper.vertices().iter().copied());
    let points: Vec<DVec3> = points.collect();
    let camera = Camera::fit(&points, &View::from_degrees(48.0, 6.0), WIDTH, HEIGHT);
    Ok(camera.render(&items, Shading::Smooth))
}

/// Draws contact levels of detail of the lower jaw, as in Fig. 3.7.
pub fn levels_of_lower_jaw() -> Result<Picture, Box<dyn Error>> {
    const SHOWN: usize = 8;
    let mesh = Model::LowerJaw.generate(Model::LowerJaw.default_triangles())?;
    let options = BuildOptions::default();
    let clod = build(&mesh, &options, &mut unwatched)?;
    let pictures = LevelPictures::new(&clod, &views::of_model(Model::LowerJaw), WIDTH);
    let last = clod.levels.len() - 1;
    let levels: BTreeSet<usize> = (0..SHOWN).map(|k| k * last / (SHOWN - 1)).collect();
    let drawn: Vec<(usize, Picture)> =
        levels.into_iter().map(|level| (level, pictures.level(level))).collect();
    Ok(pictures.sheet(&drawn))
}

/// Draws a nut on its bolt, and a peg that is put into its hole aslant.
pub fn assemblies() -> Result<[(&'static str, Picture); 2], Box<dyn Error>> {
    let [bolt, nut, peg, hole] = [Model::Bolt, Model::Nut, Model::Peg, Model::Hole]
        .map(|model| model.generate(model.default_triangles()));
    let (bolt, nut, peg, hole) = (bolt?, nut?, peg?, hole?);
    let thread = MetricThread::M16;
    let turns = 0.5 * thread.bolt_length() / thread.pitch;
    let (rotation, translation) = (DQuat::from_rotation_z(TAU * turns), DVec3::Z * turns * thread.pitch);
    let screwed =
        picture(&[Item::new(&bolt, STEEL), Item { rotation, translation, ..Item::new(&nut, BRASS) }], -60.0);
    let (rotation, translation) = (DQuat::from_rotation_x(PEG_TILT.to_radians()), DVec3::Z * -4e-3);
    let inserted =
        picture(&[Item { rotation, translation, ..Item::new(&peg, BRASS) }, Item::new(&hole, STEEL)], -60.0);
    Ok([("nut-on-bolt", screwed), ("peg-in-hole", inserted)])
}

/// Items seen from an azimuth (degrees), from a little above.
fn picture(items: &[Item<'_>], azimuth: f64) -> Picture {
    let points = items.iter().flat_map(|item| {
        item.mesh.vertices().iter().map(|vertex| item.rotation * *vertex + item.translation)
    });
    let points: Vec<DVec3> = points.collect();
    let camera = Camera::fit(&points, &View::from_degrees(azimuth, 25.0), WIDTH, HEIGHT);
    camera.render(items, Shading::Smooth)
}

/// Returns the height (m) by which the lower points can be lifted until they touch the upper ones: the
/// smallest gap over all columns of a grid.
fn clearance(lower: &[DVec3], upper: &[DVec3]) -> f64 {
    const CELL: f64 = 5e-4;
    let column = |point: &DVec3| ((point.x / CELL).floor() as i64, (point.y / CELL).floor() as i64);
    let mut heights: HashMap<(i64, i64), f64> = HashMap::new();
    for point in lower {
        let height = heights.entry(column(point)).or_insert(point.z);
        *height = height.max(point.z);
    }
    let gap = |point: &DVec3| heights.get(&column(point)).map(|height| point.z - height);
    upper.iter().filter_map(gap).fold(f64::INFINITY, f64::min)
}
