//! Held objects and the objects that they touch: small models, built once.

use std::sync::OnceLock;

use palpate::Object;
use palpate::glam::DVec3;
use palpate_tests::{model, ridged_plate};

use crate::stability::meshes;

/// Held object and scene object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pair {
    Ellipsoid,
    Blocks,
    SpoonInCup,
    PegInHole,
    Stylus,
    Jaws,
    Ridges,
}

pub const PAIRS: [Pair; 7] = [
    Pair::Ellipsoid,
    Pair::Blocks,
    Pair::SpoonInCup,
    Pair::PegInHole,
    Pair::Stylus,
    Pair::Jaws,
    Pair::Ridges,
];

impl Pair {
    /// Returns the held object and the scene object.
    pub fn objects(self) -> &'static (Object, Object) {
        static MADE: [OnceLock<(Object, Object)>; PAIRS.len()] = [const { OnceLock::new() }; PAIRS.len()];
        MADE[self as usize].get_or_init(|| {
            // In threads of their own: all of rayon's, in which sessions run, may be waiting here.
            let make = || {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
                pool.map_err(|error| error.to_string())?.install(|| self.make())
            };
            let made = std::thread::scope(|scope| scope.spawn(make).join());
            made.expect("no panic").unwrap_or_else(|error| panic!("{error}"))
        })
    }

    fn make(self) -> Result<(Object, Object), String> {
        Ok(match self {
            Self::Ellipsoid => (model("ellipsoid@500"), model("golf-ball@2000")),
            Self::Blocks => (
                meshes::block("block", DVec3::new(0.012, 0.010, 0.008))?,
                meshes::block("table", DVec3::new(0.06, 0.06, 0.02))?,
            ),
            Self::SpoonInCup => (model("spoon-low"), model("cup-low@1000")),
            Self::PegInHole => (meshes::peg(5e-3, 0.04)?, meshes::hole(5.2e-3, 0.012, 0.03)?),
            Self::Stylus => (model("stylus@500"), model("torus@1000")),
            Self::Jaws => (model("lower-jaw@3000"), model("upper-jaw@3000")),
            Self::Ridges => (model("stylus@500"), ridged_plate(1e-3, 4e-3)),
        })
    }

    /// Returns the bounding radius of the held object, m.
    pub fn radius(self) -> f64 {
        self.objects().0.bounding_radius()
    }

    /// Returns the rate of contact queries that a busy processor keeps up with, Hz.
    pub fn most_queries(self) -> f64 {
        match self {
            Self::Ellipsoid | Self::Blocks => 1000.0,
            Self::SpoonInCup | Self::PegInHole | Self::Stylus => 300.0,
            Self::Jaws | Self::Ridges => 60.0,
        }
    }
}
