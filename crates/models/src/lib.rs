//! Procedural benchmark models: the objects of the dissertation's Tables 3.2 and 4.1 and of §5.5.3, a jaw of
//! forceps, and parts to assemble, generated deterministically at any resolution.
//!
//! Every model is a closed 2-manifold, consistently oriented (outwards), without self-intersections, in
//! metres.

mod ball_joint;
mod block;
mod box_lattice;
mod cad_part;
mod cup;
mod ellipsoid;
mod file;
mod forceps_jaw;
mod gear;
mod golf_ball;
mod golf_club;
mod halfedge;
mod hammer;
mod jaws;
mod lathe;
mod path;
mod peg;
mod plate;
mod relief;
mod remesh;
mod spoon;
mod stitched;
mod stylus;
mod surface;
mod tetrahedra;
mod thread;
mod torus;
mod window;

pub use jaws::JawPart;
use palpate_core::TriMesh;
pub use peg::PegFit;
pub use thread::MetricThread;

/// A built-in model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Model {
    /// Lower jaw: gums and teeth in an arch, bounded by a 6 cm sphere (Table 3.2). z up, y forward; the teeth
    /// point up, the occlusal plane is near z = 0. At equal poses the jaws are closed, a few tenths of a
    /// millimetre apart.
    LowerJaw,
    /// Upper jaw, whose teeth interdigitate with the lower jaw's (Table 3.2). Same frame as the lower jaw;
    /// the teeth point down.
    UpperJaw,
    /// Ball half of the interlocking ball joint (Table 3.2). Both halves have the ball's centre as origin, so
    /// that the joint is assembled at equal poses; the ball's stem points down (−z).
    BallJointBall,
    /// Socket half of the interlocking ball joint (Table 3.2); its stem points up (+z).
    BallJointSocket,
    /// Golf club head with hosel and shaft (Table 3.2). The origin is the middle of the face, z up, the shot
    /// goes along +x, the toe points along −y; real size, to suit the ball.
    GolfClub,
    /// Golf ball with some 330 dimples, 21.335 mm in radius, about the origin (Table 3.2).
    GolfBall,
    /// Cup with a handle, radius 8 cm (Table 3.2, §5.5.3).
    Cup,
    /// Spoon, 20 cm long (Table 3.2, §5.5.2).
    Spoon,
    /// The cup of §5.5.3, at low resolution.
    CupLow,
    /// The spoon of §5.5.3, at low resolution.
    SpoonLow,
    /// The convex ellipsoid that explores the golf ball in §3.5.2.
    Ellipsoid,
    /// Textured block (Table 4.1).
    Block,
    /// Textured gear (Table 4.1).
    Gear,
    /// Textured hammer (Table 4.1).
    Hammer,
    /// Textured CAD part (Table 4.1).
    CadPart,
    /// File (the hand tool), cross-cut (Table 4.1).
    File,
    /// Helicoidal torus (Table 4.1).
    Torus,
    /// Probe with a spherical tip, upright; the tip's centre is the origin (§5.5.4).
    Stylus,
    /// Flat plate that the stylus explores; its upper face is in the plane z = 0 (§5.5.4).
    Plate,
    /// Jaw of forceps for a tool of two bodies (§6.2.3). The hinge's axis is z through the origin, the beak
    /// lies along x, its gripping face in the plane y = 0; the other jaw is the same, turned half a turn
    /// about x.
    ForcepsJaw,
    /// Bolt M16 × 2 with its head, in the middle of the tolerance 6g ([`MetricThread::M16`]). The axis is z,
    /// the head bears at z = 0, the shank points up.
    Bolt,
    /// Nut M16 × 2 in the middle of the tolerance 6H. The axis is z, the centre is the origin. Bolt and nut
    /// are engaged at equal poses, and wherever the nut is turned by φ about z and moved by 2 mm · φ/2π
    /// along it.
    Nut,
    /// Peg of 8 mm, chamfered, that stands on its tip at the origin ([`PegFit::LOOSE_8_MM`]).
    Peg,
    /// Block with a chamfered hole for the peg, 0.05 mm wider all around, its mouth about the origin.
    Hole,
}

/// Error of naming or generating a model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// No built-in model has this name.
    #[error("no built-in model is called '{name}'; the names are: {known}")]
    Unknown {
        /// The name given.
        name: String,
        /// The names of all models.
        known: String,
    },
    /// The text after `@` is not a number of triangles.
    #[error("'{text}' is not a number of triangles; write for example {model}@20000")]
    BadCount {
        /// The model's name.
        model: &'static str,
        /// The text in place of a number.
        text: String,
    },
    /// The number of triangles is out of the model's range.
    #[error("{model} can be generated with {min} to {max} triangles, not {asked}")]
    OutOfRange {
        /// The model's name.
        model: &'static str,
        /// Number of triangles requested.
        asked: usize,
        /// Smallest number of triangles.
        min: usize,
        /// Largest number of triangles.
        max: usize,
    },
    /// The dimensions are not those of such a model.
    #[error("the dimensions of a {model} are out of range: {expected}")]
    Dimensions {
        /// The model's name.
        model: &'static str,
        /// What they should be.
        expected: &'static str,
    },
}

/// Name, default size and description of a model.
struct Entry {
    model: Model,
    name: &'static str,
    /// Default number of triangles.
    triangles: usize,
    description: &'static str,
}

/// All models, in the order of [`Model`]'s variants. A table rather than a `match`: LLVM 22 unrolls a search
/// over such a `match` into 400 comparisons, on which its constraint elimination spends minutes (`opt-level =
/// 3`).
static ENTRIES: [Entry; 24] = [
    entry(Model::LowerJaw, "lower-jaw", 40_180, "lower jaw, an arch of teeth (Table 3.2)"),
    entry(Model::UpperJaw, "upper-jaw", 47_339, "upper jaw, interdigitates with the lower (Table 3.2)"),
    entry(Model::BallJointBall, "ball-joint-ball", 137_060, "ball half of a ball joint (Table 3.2)"),
    entry(Model::BallJointSocket, "ball-joint-socket", 137_060, "socket half of a ball joint (Table 3.2)"),
    entry(Model::GolfClub, "golf-club", 104_888, "golf club head and shaft (Table 3.2)"),
    entry(Model::GolfBall, "golf-ball", 177_876, "golf ball with dimples (Table 3.2)"),
    entry(Model::Cup, "cup", 64_000, "cup with handle (Table 3.2)"),
    entry(Model::Spoon, "spoon", 86_016, "spoon, 20 cm (Table 3.2)"),
    entry(Model::CupLow, "cup-low", 4_000, "cup of §5.5.3"),
    entry(Model::SpoonLow, "spoon-low", 1_344, "spoon of §5.5.3"),
    entry(Model::Ellipsoid, "ellipsoid", 2_000, "convex ellipsoid of §3.5.2"),
    entry(Model::Block, "block", 65_536, "textured block (Table 4.1)"),
    entry(Model::Gear, "gear", 25_600, "textured gear (Table 4.1)"),
    entry(Model::Hammer, "hammer", 433_152, "textured hammer (Table 4.1)"),
    entry(Model::CadPart, "cad-part", 658_432, "textured CAD part (Table 4.1)"),
    entry(Model::File, "file", 285_824, "cross-cut file (Table 4.1)"),
    entry(Model::Torus, "torus", 128_000, "helicoidal torus (Table 4.1)"),
    entry(Model::Stylus, "stylus", 20_000, "probe with a spherical tip of §5.5.4"),
    entry(Model::Plate, "plate", 12, "flat plate of §5.5.4"),
    entry(Model::ForcepsJaw, "forceps-jaw", 2_000, "jaw of forceps with its hinge (§6.2.3)"),
    entry(Model::Bolt, "bolt", 24_000, "bolt M16 with its thread, 6g"),
    entry(Model::Nut, "nut", 14_000, "nut M16 with its thread, 6H"),
    entry(Model::Peg, "peg", 1_000, "chamfered peg, 8 mm"),
    entry(Model::Hole, "hole", 1_200, "block with a hole for the peg, 0.05 mm wider all around"),
];

const fn entry(model: Model, name: &'static str, triangles: usize, description: &'static str) -> Entry {
    Entry { model, name, triangles, description }
}

/// Largest number of triangles of a model.
pub const MAX_TRIANGLES: usize = 20_000_000;

impl Model {
    /// All models, in the order of the tables.
    pub const ALL: [Self; 24] = {
        let mut all = [Self::LowerJaw; 24];
        let mut index = 0;
        while index < all.len() {
            all[index] = ENTRIES[index].model;
            index += 1;
        }
        all
    };

    /// The model's name on the command line.
    pub const fn name(self) -> &'static str {
        self.entry().name
    }

    /// The number of triangles in the dissertation's tables, or one that suits the model where they have
    /// none.
    pub const fn default_triangles(self) -> usize {
        self.entry().triangles
    }

    /// Description of the model in a few words.
    pub const fn description(self) -> &'static str {
        self.entry().description
    }

    const fn entry(self) -> &'static Entry {
        &ENTRIES[self as usize]
    }

    /// Generates the model with about `triangles` triangles (within 2 %, or the nearest the model's structure
    /// allows).
    ///
    /// # Errors
    /// If `triangles` is fewer than the model's shape needs, or more than [`MAX_TRIANGLES`].
    pub fn generate(self, triangles: usize) -> Result<TriMesh, ModelError> {
        let (min, build): (usize, fn(usize) -> TriMesh) = match self {
            Self::LowerJaw => (jaws::MIN_TRIANGLES, jaws::lower),
            Self::UpperJaw => (jaws::MIN_TRIANGLES, jaws::upper),
            Self::BallJointBall => (ball_joint::MIN_TRIANGLES, ball_joint::ball),
            Self::BallJointSocket => (ball_joint::MIN_TRIANGLES, ball_joint::socket),
            Self::GolfClub => (golf_club::MIN_TRIANGLES, golf_club::build),
            Self::GolfBall => (golf_ball::MIN_TRIANGLES, golf_ball::build),
            Self::Cup | Self::CupLow => (cup::MIN_TRIANGLES, cup::build),
            Self::Spoon | Self::SpoonLow => (spoon::MIN_TRIANGLES, spoon::build),
            Self::Ellipsoid => (ellipsoid::MIN_TRIANGLES, ellipsoid::build),
            Self::Block => (block::MIN_TRIANGLES, block::build),
            Self::Gear => (gear::MIN_TRIANGLES, gear::build),
            Self::Hammer => (hammer::MIN_TRIANGLES, hammer::build),
            Self::CadPart => (cad_part::MIN_TRIANGLES, cad_part::build),
            Self::File => (file::MIN_TRIANGLES, file::build),
            Self::Torus => (torus::MIN_TRIANGLES, torus::build),
            Self::Stylus => (stylus::MIN_TRIANGLES, stylus::build),
            Self::Plate => (plate::MIN_TRIANGLES, plate::build),
            Self::ForcepsJaw => (forceps_jaw::MIN_TRIANGLES, forceps_jaw::build),
            Self::Bolt => (thread::MIN_BOLT_TRIANGLES, |count| thread::bolt(&MetricThread::M16, count)),
            Self::Nut => (thread::MIN_NUT_TRIANGLES, |count| thread::nut(&MetricThread::M16, count)),
            Self::Peg => (peg::MIN_TRIANGLES, |count| peg::peg(&PegFit::LOOSE_8_MM, count)),
            Self::Hole => (peg::MIN_TRIANGLES, |count| peg::hole(&PegFit::LOOSE_8_MM, count)),
        };
        if !(min..=MAX_TRIANGLES).contains(&triangles) {
            return Err(ModelError::OutOfRange {
                model: self.name(),
                asked: triangles,
                min,
                max: MAX_TRIANGLES,
            });
        }
        Ok(build(triangles))
    }

    /// Reads `NAME` or `NAME@TRIANGLES`: the model and the number of triangles asked for.
    ///
    /// # Errors
    /// If there is no such model, or the text after `@` is not a number.
    pub fn parse(text: &str) -> Result<(Self, usize), ModelError> {
        let (name, count) = match text.split_once('@') {
            Some((name, count)) => (name, Some(count)),
            None => (text, None),
        };
        let entry = ENTRIES.iter().find(|entry| entry.name == name).ok_or_else(|| {
            let known: Vec<&str> = ENTRIES.iter().map(|entry| entry.name).collect();
            ModelError::Unknown { name: name.to_owned(), known: known.join(", ") }
        })?;
        let model = entry.model;
        let triangles = match count {
            None => model.default_triangles(),
            Some(text) => text
                .parse()
                .map_err(|_| ModelError::BadCount { model: model.name(), text: text.to_owned() })?,
        };
        Ok((model, triangles))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_the_order_of_the_variants() {
        for (index, entry) in ENTRIES.iter().enumerate() {
            assert_eq!((entry.model as usize, entry.model.name()), (index, entry.name));
        }
    }
}
