//! Plain scenes at random: blocks, prisms, cylinders, balls, needles and tori, triangulated at random, that a
//! probe slides over, falls into and goes past with the session's default settings.
//!
//! Each step is held against what is known of it without the engine. Along directions in which the scene
//! does not change, nothing pushes a body without friction: not along a flat floor, nor along a slot or a
//! ridge. Convex pieces of the two bodies do not overlap ([`oracle`](super::oracle)). While everything is
//! further away than the body has moved since the newest contact query, it follows the hand as in an empty
//! scene.

use std::f64::consts::TAU;
use std::fmt::{self, Write as _};

use palpate::device::Emulation;
use palpate::glam::{DQuat, DVec2, DVec3};
use palpate::{HandlePlacement, Object, Pose, Record, Scene, Settings};
use rand::RngExt as _;
use rand::rngs::StdRng;

use super::genome::{Genes, Genome, mixed};
use super::oracle::Oracle;
use super::route::Route;
use super::search::{Column, Trial};
use super::session::{Ended, Outcome};
use super::solids::{Solid, Tessellation, polygon, rectangle};
use crate::stability::port::driven::{Driven, PERIOD, rounded};

/// Distance in bounding radii up to which surfaces touch: somewhat more than that at which they are held
/// apart.
const HELD: f64 = 1e-4;

/// Largest contact force along a direction in which the scene does not change, N.
const MAX_SIDEWAYS: f64 = 0.01;
/// Largest overlap, m: for probes of a radius up to 0.1 m and down to 10 mm. It is the same share of larger
/// and of smaller ones, as the tolerance d is.
const MAX_OVERLAP: f64 = 2e-5;
const USUAL_RADIUS: (f64, f64) = (0.01, 0.1);
/// Largest force beyond that in an empty scene, N, and largest distance from the place there, m, where
/// everything is far away.
const MAX_DRAG: f64 = 0.05;
const MAX_LAG: f64 = 5e-4;
/// Smallest radius of a ball, m.
const MIN_BALL: f64 = 6e-4;
/// Distance, in radii of the probe, up to which a body may be touched in a step.
const NEAR: f64 = 0.02;
/// Age of the newest contact model, contact intervals: its query takes one, and it is in use for another.
const MODEL_AGE: f64 = 2.0;
/// Time after which the coupling has come to rest where the probe has left surfaces, s and contact
/// intervals.
const SETTLING: (f64, f64) = (0.15, 6.0);
/// Speed at which a probe that was held comes back to a place far away at least, m/s: the coupling's force is
/// limited.
const COMING_BACK: f64 = 0.3;

/// What a probe does in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Slides on a flat floor, on a face, an edge or a corner; or on one made of blocks side by side.
    Floor,
    Tiles,
    /// Goes down into a slot and along it.
    Slot,
    /// Slides along or across a ridge.
    Ridge,
    /// Is pressed onto corners.
    Corners,
    /// Stands in a ring of balls, or lies on it.
    Bearing,
    /// Pokes a floor, and is dragged along it.
    Needle,
    /// Goes about between bodies that lie anywhere.
    Clutter,
}

impl Kind {
    const ALL: [Self; 8] = [
        Self::Floor,
        Self::Tiles,
        Self::Slot,
        Self::Ridge,
        Self::Corners,
        Self::Bearing,
        Self::Needle,
        Self::Clutter,
    ];
}

/// Scenes that the bodies of a genome are put into, since making their fields takes longer than a session.
pub const VARIATIONS: usize = 6;

/// One of the scenes that a genome encodes.
struct Plan {
    kind: Kind,
    /// Radius of the probe, m.
    radius: f64,
    probe: Solid,
    /// Solids, and those of them that lie at poses.
    solids: Vec<Solid>,
    placed: Vec<(usize, Pose)>,
    /// Directions in which the scene does not change where the probe is, world axes; and the number of
    /// bodies of which that is true. The others are beside the route.
    even: Vec<DVec3>,
    uniform: usize,
    route: Route,
    speed: f64,
    /// Rate of contact queries, Hz.
    rate: f64,
}

/// A scene in the making, in axes in which the floor is level.
struct Draft<'g, 'r> {
    /// Numbers of the bodies, and random numbers of their triangles.
    g: &'r mut Genes<'g>,
    rng: &'r mut StdRng,
    /// Numbers of the scene: hands and poses; and random numbers of places.
    h: &'r mut Genes<'g>,
    places: &'r mut StdRng,
    radius: f64,
    speed: f64,
    rate: f64,
    solids: Vec<Solid>,
    placed: Vec<(usize, Pose)>,
}

impl Plan {
    fn of(genome: &Genome, variation: usize) -> Self {
        let other = Genome::new(mixed(genome.rng().random::<u64>() ^ variation as u64));
        let (mut genes, mut rng, mut hands, mut places) =
            (genome.genes(), genome.rng(), other.genes(), other.rng());
        let (g, h) = (&mut genes, &mut hands);
        let kind = g.pick(&[&Kind::ALL[..], &[Kind::Floor, Kind::Floor]].concat());
        let radius = g.log_or((5e-3, 0.06), 0.25, (1.05e-3, 1.0));
        let speed = h.log(0.02, 2.0);
        let rate = h.log(30.0, 1000.0);
        let axes = (h.chance(0.5), h.turn(3.0), h.vector(0.1));
        let mut draft = Draft {
            g,
            rng: &mut rng,
            h,
            places: &mut places,
            radius,
            speed,
            rate,
            solids: vec![],
            placed: vec![],
        };
        let (probe, route, even) = match kind {
            Kind::Floor | Kind::Tiles | Kind::Needle => draft.on_floor(kind),
            Kind::Slot => draft.in_slot(),
            Kind::Ridge => draft.on_ridge(),
            Kind::Corners => draft.on_corners(),
            Kind::Bearing => draft.in_bearing(),
            Kind::Clutter => draft.in_clutter(),
        };
        let uniform = draft.placed.len();
        draft.beside(&route);
        let Draft { solids, placed, .. } = draft;
        let axes = if axes.0 { Pose::new(axes.2, axes.1) } else { Pose::IDENTITY };
        Self {
            kind,
            radius,
            probe,
            solids,
            placed: placed.into_iter().map(|(solid, pose)| (solid, axes * pose)).collect(),
            even: even.into_iter().map(|along| axes.rotation * along).collect(),
            uniform,
            route: route.placed(&axes),
            speed,
            rate,
        }
    }
}

impl fmt::Debug for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:?}: probe of {:.4} m with {} corners, {} objects, {:.3} m/s, {:.1} Hz, {:.2} s",
            self.kind,
            self.radius,
            self.probe.vertices.len(),
            self.placed.len(),
            self.speed,
            self.rate,
            self.route.last().0
        )
    }
}

impl Draft<'_, '_> {
    /// Draws how a solid's triangles are divided, up to a number of triangles.
    fn tessellation(&mut self, most: f64) -> Tessellation {
        let (plain, quarters) = (self.g.chance(0.3), self.g.pick(&[0, 0, 0, 1, 2, 3]));
        let splits = self.g.maybe(0.6, |g| g.log(2.0, most) as usize).unwrap_or(0);
        let (evenness, margin) = (self.g.range(0.0, 1.0), self.g.log(0.01, 0.45));
        Tessellation {
            quarters: if plain || most < 100.0 { 0 } else { quarters },
            splits: if plain { 0 } else { splits },
            evenness,
            margin,
        }
    }

    /// Draws a convex solid or a ring with a radius of 1 about its middle.
    fn shape(&mut self) -> Solid {
        let which = self.g.pick(&[0, 0, 1, 2, 3, 4, 5, 6]);
        let (a, b, c) = (self.g.log(0.2, 1.0), self.g.log(0.2, 1.0), self.g.log(0.2, 1.0));
        let (few, many) = (self.g.range(3.0, 9.0) as usize, self.g.range(12.0, 40.0) as usize);
        let (rng, flat) = (&mut *self.rng, DVec2::new);
        let solid = match which {
            0 => Solid::block(DVec3::new(a, b, c), rng),
            1 => Solid::prism(&polygon(few, a), 2.0 * b, rng),
            2 => Solid::prism(&polygon(many, a), 2.0 * b, rng),
            3 => Solid::ball(1.0, many / 2, many, rng),
            4 => Solid::turned(&[flat(a, -b), flat(0.5 * a * c, b)], many, rng),
            5 => Solid::turned_ring(&rectangle(flat(0.3 * a, b)).map_x(0.3 * a + c), many),
            _ => Solid::turned_ring(&polygon(few.max(5), 0.4 * a).map_x(0.4 * a + c), many),
        };
        solid.of_radius(1.0)
    }

    /// Draws the probe, and triangles for it.
    fn probe(&mut self, shape: Solid) -> Solid {
        let how = self.tessellation(300.0);
        shape.of_radius(self.radius).tessellated(&how, self.rng)
    }

    fn add(&mut self, solid: Solid, pose: Pose) -> usize {
        self.solids.push(solid);
        self.placed.push((self.solids.len() - 1, pose));
        self.solids.len() - 1
    }

    /// Adds a floor with its top at z = 0, of half sides in radii of the probe, as one block or as some side
    /// by side.
    fn floor(&mut self, half: DVec2, tiles: usize) {
        let height = self.radius * self.g.range(0.2, 1.0);
        let each = DVec3::new(half.x * self.radius / tiles as f64, half.y * self.radius, 0.5 * height);
        let how = self.tessellation(600.0);
        let tile = Solid::block(each, self.rng).tessellated(&how, self.rng);
        for index in 0..tiles {
            let x = (2.0 * index as f64 + 1.0 - tiles as f64) * each.x;
            let pose = Pose::from_translation(DVec3::new(x, 0.0, -each.z));
            match index {
                0 => drop(self.add(tile.clone(), pose)),
                _ => self.placed.push((self.solids.len() - 1, pose)),
            }
        }
    }

    /// Draws an orientation: as made, turned about z, on another side, or any.
    fn orientation(&mut self) -> DQuat {
        let (yaw, any) = (DQuat::from_rotation_z(self.h.range(0.0, TAU)), self.h.turn(3.1));
        let side = self.h.pick(&[0.0, 0.0, 0.5, 1.0]) * std::f64::consts::PI;
        if self.h.chance(0.3) { any } else { yaw * DQuat::from_rotation_x(side) }
    }

    /// Starts a route above the level at which a probe touches z = `level`, with a rest.
    fn above(&mut self, probe: &Solid, turn: DQuat, at: DVec2, level: f64) -> Route {
        let lowest = probe.vertices.iter().map(|point| (turn * *point).z).fold(f64::INFINITY, f64::min);
        let height = self.radius * self.h.log(0.05, 3.0);
        let pose = Pose::new(at.extend(level - lowest + height), turn);
        let mut route = Route::from(pose, self.speed);
        route.rest(self.h.range(0.0, 4.0) / self.rate);
        // The depth of the hand below the surface: its force is that of the coupling.
        let pressed = self.h.log(2e-4, 8e-3);
        route.shift(-DVec3::Z * (height + pressed));
        route
    }

    /// Ends a route far above, in free air.
    fn leave(&self, route: &mut Route) {
        let far = (self.speed * 0.8).min(0.05 + 4.0 * self.radius);
        route.shift(DVec3::Z * far);
        route.rest(SETTLING.0 + (SETTLING.1 + 4.0) / self.rate);
    }

    /// Slides to some places within half sides.
    fn slide(&mut self, route: &mut Route, half: DVec2) {
        let moves = self.h.range(1.0, 4.0) as usize;
        for _ in 0..moves {
            let to = DVec2::new(self.h.range(-1.0, 1.0), self.h.range(-1.0, 1.0)) * half;
            let by = to.extend(0.0) - route.last().1.translation.truncate().extend(0.0);
            // Slow hands do not go far.
            route.shift(by.clamp_length_max(self.speed * 0.8));
        }
    }

    fn on_floor(&mut self, kind: Kind) -> (Solid, Route, Vec<DVec3>) {
        let needle = kind == Kind::Needle;
        let slim = self.g.log(0.01, 0.2);
        let (corners, point) = (self.g.range(3.0, 12.0) as usize, self.g.pick(&[0.0, 0.0, 0.05, 1.0]));
        let shape = self.shape();
        let shape = if needle {
            let flat = DVec2::new;
            Solid::turned(&[flat(point * slim, -1.0), flat(slim, 1.0)], corners, self.rng)
        } else {
            shape
        };
        let probe = self.probe(shape);
        let half = DVec2::new(self.g.range(1.2, 2.5), self.g.range(1.2, 1.6));
        let count = self.g.range(2.0, 10.0) as usize;
        self.floor(half, if kind == Kind::Tiles { count } else { 1 });
        let turn = self.orientation();
        let turn = if needle { self.h.turn(0.7) } else { turn };
        // The whole probe stays over the floor, even where it tips over.
        let room = (half - 1.1) * self.radius;
        let at = DVec2::new(self.h.range(-1.0, 1.0), self.h.range(-1.0, 1.0)) * room;
        let mut route = self.above(&probe, turn, at, 0.0);
        self.slide(&mut route, room);
        self.leave(&mut route);
        (probe, route, vec![DVec3::X, DVec3::Y])
    }

    fn in_slot(&mut self) -> (Solid, Route, Vec<DVec3>) {
        let (a, b, c) = (self.g.log(0.3, 1.0), self.g.log(0.3, 1.0), self.g.log(0.3, 1.0));
        let block = Solid::block(DVec3::new(a, b, c), self.rng);
        let probe = self.probe(block);
        let width = probe.vertices.iter().map(|point| point.y).fold(0.0, f64::max);
        let clearance = self.g.maybe(0.6, |g| g.log(1e-4, 0.1)).unwrap_or(0.0) * width;
        let (wall, length) = (self.radius * self.g.range(0.3, 1.0), self.radius * self.g.range(1.5, 2.5));
        let height = self.radius * self.g.range(0.3, 1.5);
        let how = self.tessellation(300.0);
        let slot = Solid::channel(length, width + clearance, wall, height, self.rng);
        let slot = slot.tessellated(&how, self.rng);
        let slot = self.add(slot, Pose::IDENTITY);
        debug_assert_eq!(slot, 0);
        let askew = self.h.chance(0.5);
        let off = if askew { self.h.range(-0.1, 0.1) * width } else { 0.0 };
        let turn = DQuat::from_rotation_z(if askew { self.h.range(-0.03, 0.03) } else { 0.0 });
        let mut route = self.above(&probe, turn, DVec2::new(0.0, off), height);
        route.shift(-DVec3::Z * height);
        let room = DVec2::new(length - 1.1 * self.radius, 0.1 * width);
        self.slide(&mut route, room);
        route.shift(DVec3::Z * height);
        self.leave(&mut route);
        (probe, route, vec![DVec3::X])
    }

    fn on_ridge(&mut self) -> (Solid, Route, Vec<DVec3>) {
        let shape = self.shape();
        let probe = self.probe(shape);
        let corners = self.g.pick(&[3, 4, 5, 6, 16, 32]);
        let (size, angle) = (self.radius * self.g.log(0.3, 2.0), self.g.range(0.0, TAU));
        let section: Vec<DVec2> =
            polygon(corners, size).into_iter().map(|p| DVec2::from_angle(angle).rotate(p)).collect();
        let length = self.radius * self.g.range(1.5, 2.5);
        let along_x = |p: DVec3| DVec3::new(p.z, p.x, p.y);
        let how = self.tessellation(400.0);
        let ridge =
            Solid::prism(&section, 2.0 * length, self.rng).mapped(along_x).tessellated(&how, self.rng);
        let top = ridge.vertices.iter().map(|point| point.z).fold(0.0, f64::max);
        self.add(ridge, Pose::IDENTITY);
        let turn = self.orientation();
        let room = DVec2::new(length - 1.1 * self.radius, size + self.radius);
        let at = DVec2::new(0.0, self.h.range(-0.7, 0.7) * size);
        let mut route = self.above(&probe, turn, at, top);
        self.slide(&mut route, room);
        self.leave(&mut route);
        (probe, route, vec![DVec3::X])
    }

    fn on_corners(&mut self) -> (Solid, Route, Vec<DVec3>) {
        let shape = self.shape();
        let probe = self.probe(shape);
        let count = self.g.range(1.0, 10.0) as usize;
        let corners = self.g.range(3.0, 7.0) as usize;
        let (width, height) = (self.radius * self.g.log(0.1, 1.0), self.radius * self.g.log(0.1, 1.5));
        let how = self.tessellation(60.0);
        let (width, height) = (width.max(6e-4), height.max(6e-4));
        let profile = [DVec2::new(width, -height), DVec2::new(0.0, 0.0)];
        let pyramid = Solid::turned(&profile, corners, self.rng).tessellated(&how, self.rng);
        let around = self.radius * self.g.log(0.2, 1.2);
        let solid = self.solids.len();
        self.solids.push(pyramid);
        for index in 0..count {
            let at = DVec2::from_angle(TAU * index as f64 / count as f64) * (around + 1.05 * width);
            let at = if count < 3 { at * 0.5 } else { at };
            // Those of a ring may come too near each other: then some are left out.
            let near = |(_, pose): &(usize, Pose)| pose.translation.truncate().distance(at) < 2.05 * width;
            if !self.placed.iter().any(near) {
                self.placed.push((solid, Pose::from_translation(at.extend(0.0))));
            }
        }
        let turn = self.orientation();
        let mut route = self.above(&probe, turn, DVec2::ZERO, 0.0);
        self.slide(&mut route, DVec2::splat(1.5 * self.radius));
        self.leave(&mut route);
        (probe, route, vec![])
    }

    fn in_bearing(&mut self) -> (Solid, Route, Vec<DVec3>) {
        let count = self.g.range(3.0, 56.0) as usize;
        let lies = self.g.chance(0.4);
        let (slim, corners) = (self.g.log(0.3, 1.0), self.g.pick(&[16, 24, 48]));
        let clearance = self.g.maybe(0.7, |g| g.log(1e-4, 0.1)).unwrap_or(0.0);
        let room = self.g.range(1.02, 1.5);
        let (rings, sides, races) = (self.g.pick(&[6, 8, 10]), self.g.pick(&[8, 12, 16]), self.g.chance(0.3));
        let shaft = Solid::prism(&polygon(corners, slim), 2.0, self.rng);
        let disc = Solid::prism(&polygon(corners, 1.0), 2.0 * 0.2, self.rng);
        let probe = self.probe(if lies { disc } else { shaft });
        let shaft = probe.vertices.iter().map(|point| point.truncate().length()).fold(0.0, f64::max);
        // Balls of a ring about the shaft just fit beside each other; those below a disc are as they may.
        let share = (std::f64::consts::PI / count as f64).sin() / room;
        let (ball, around) = if lies {
            (shaft * (0.7 * share).min(0.4), 0.7 * shaft)
        } else {
            // The distance of their middles, a + r = r / share, where the clearance is 0.
            let ball = (shaft * (1.0 + clearance) / (1.0 / share - 1.0)).min(2.0 * self.radius);
            let ball = ball.max(MIN_BALL);
            (ball, (shaft * (1.0 + clearance) + ball).max(ball / share))
        };
        let ball = ball.max(MIN_BALL);
        let solid = self.solids.len();
        self.solids.push(Solid::ball(ball, rings, sides, self.rng));
        for index in 0..count {
            let turn = TAU * index as f64 / count as f64;
            let at = DVec2::from_angle(turn) * around;
            self.placed.push((solid, Pose::new(at.extend(0.0), DQuat::from_rotation_z(turn))));
        }
        if races && !lies {
            let inner = around + 1.1 * ball;
            let section = rectangle(DVec2::new(0.2 * ball, ball)).map_x(inner + 0.2 * ball);
            self.add(Solid::turned_ring(&section, 32), Pose::IDENTITY);
        }
        let route = if lies {
            let turn = self.h.turn(0.2);
            let mut route = self.above(&probe, turn, DVec2::ZERO, ball);
            self.slide(&mut route, DVec2::splat(0.3 * shaft));
            self.leave(&mut route);
            route
        } else {
            let mut route = Route::from(Pose::IDENTITY, self.speed);
            route.rest(self.h.range(0.0, 4.0) / self.rate);
            for _ in 0..3 {
                let to = DVec2::from_angle(self.h.range(0.0, TAU)) * self.h.log(2e-4, 8e-3);
                let turn = DQuat::from_rotation_z(self.h.range(-0.6, 0.6));
                route.go(Pose::new(to.extend(self.h.range(-0.2, 0.2) * self.radius), turn));
            }
            route.go(Pose::IDENTITY);
            self.leave(&mut route);
            route
        };
        (probe, route, vec![])
    }

    fn in_clutter(&mut self) -> (Solid, Route, Vec<DVec3>) {
        let shape = self.shape();
        let probe = self.probe(shape);
        let turn = self.h.turn(3.1);
        let start = DVec3::new(0.0, 0.0, 5.5 * self.radius);
        let mut route = Route::from(Pose::new(start, turn), self.speed);
        route.rest(self.h.range(0.0, 4.0) / self.rate);
        for _ in 0..3 {
            let to = self.h.vector(2.5 * self.radius);
            let by = (to - route.last().1.translation).clamp_length_max(self.speed * 0.8);
            let turn = self.h.turn(1.0);
            let (_, Pose { translation, rotation }) = route.last();
            route.go(Pose::new(translation + by, turn * rotation));
        }
        route.go(Pose::new(start, turn));
        self.leave(&mut route);
        let count = self.g.log(2.0, 50.0) as usize;
        let (kinds, size) = (self.g.range(1.0, 4.0) as usize, self.g.log(0.2, 1.0));
        self.scatter(count, (kinds, size), 4.0, |_, at, radius| {
            at.distance(start) > radius + 1.2 * start.z / 5.5
        });
        (probe, route, vec![])
    }

    /// Adds bodies near the route that the probe does not come to on it.
    fn beside(&mut self, route: &Route) {
        let crowded = self.g.chance(0.4);
        let count = self.g.log(2.0, 50.0) as usize;
        let (kinds, size) = (self.g.range(1.0, 3.0) as usize, self.g.log(0.1, 0.5));
        let most = 60_usize.saturating_sub(self.placed.len());
        let count = if crowded { count.min(most) } else { 0 };
        let stops: Vec<DVec3> = route.stops().map(|pose| pose.translation).collect();
        let reach = 1.1 * self.radius;
        self.scatter(count, (kinds, size), 3.5, move |placed, at, radius| {
            let from = |[a, b]: [DVec3; 2]| {
                let along = b - a;
                let part = ((at - a).dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
                at.distance(a + along * part)
            };
            // Above the floor, and not within what lies at the origin.
            let low = placed.first().is_some_and(|pose| at.z < pose.translation.z);
            !low && at.z > radius + 0.02 * reach
                && stops.windows(2).all(|ends| from([ends[0], ends[1]]) > reach + radius)
        });
    }

    /// Adds bodies of some kinds and a size (both relative to the probe's radius) within a distance, where
    /// they are allowed, and do not touch each other.
    fn scatter(
        &mut self,
        count: usize,
        (kinds, size): (usize, f64),
        within: f64,
        is_allowed: impl Fn(&[Pose], DVec3, f64) -> bool,
    ) {
        let first = self.solids.len();
        // All are drawn, so that the count changes nothing else.
        for _ in 0..3 {
            let shape = self.shape();
            let how = self.tessellation(80.0);
            let radius = (size * self.radius).max(6e-4);
            if self.solids.len() < first + kinds.max(1) && count > 0 {
                self.solids.push(shape.of_radius(radius).tessellated(&how, self.rng));
            }
        }
        for index in 0..count {
            let solid = first + index % (self.solids.len() - first);
            let radius = self.solids[solid].radius();
            for _ in 0..30 {
                let unit = DVec3::from_array([(); 3].map(|()| self.places.random_range(-1.0..1.0)));
                let at = unit * (within * self.radius);
                let apart = self.placed.iter().all(|(other, pose)| {
                    // Long bodies are known by their bounds, turned ones by their radius.
                    let local = pose.inverse().transform_point(at);
                    let (low, high) = self.solids[*other].bounds();
                    local.distance(local.clamp(low, high)) > 1.02 * radius
                });
                let poses: Vec<Pose> = self.placed.iter().map(|(_, pose)| *pose).collect();
                if apart && is_allowed(&poses, at, radius) {
                    let turn = DQuat::from_scaled_axis(DVec3::from_array(
                        [(); 3].map(|()| self.places.random_range(-1.8..1.8)),
                    ));
                    self.placed.push((solid, Pose::new(at, turn)));
                    break;
                }
            }
        }
    }
}

/// Polygons moved along x.
trait Moved {
    fn map_x(self, by: f64) -> Vec<DVec2>;
}

impl Moved for Vec<DVec2> {
    fn map_x(self, by: f64) -> Vec<DVec2> {
        self.into_iter().map(|point| point + DVec2::new(by, 0.0)).collect()
    }
}

/// Largest value of a quantity, relative to its bound, and when.
#[derive(Clone, Copy, Debug, Default)]
struct Largest {
    part: f64,
    value: f64,
    time: f64,
}

impl Largest {
    fn take(&mut self, value: f64, bound: f64, time: f64) {
        let part = if value.is_finite() { value / bound } else { f64::INFINITY };
        if part > self.part {
            *self = Self { part, value, time };
        }
    }
}

const NAMES: [(&str, &str); 4] =
    [("sideways force", "N"), ("overlap", "m"), ("force in free air", "N"), ("lag in free air", "m")];

/// Random scenes.
pub struct Scenes;

impl Trial for Scenes {
    fn columns(&self) -> Vec<Column> {
        NAMES.map(|(name, _)| Column { name: name.to_owned(), is_promised: true, is_sought: true }).into()
    }

    fn run(&self, genome: &Genome) -> Outcome {
        Outcome::caught(|| {
            let mut all = Ended { parts: vec![0.0; NAMES.len()], ..Ended::default() };
            let mut bodies = None;
            for variation in 0..VARIATIONS {
                let plan = Plan::of(genome, variation);
                let (probe, objects) = match &bodies {
                    Some(bodies) => bodies,
                    None => bodies.insert(plan.bodies()?),
                };
                let ended = plan.run(probe, objects)?;
                all.parts.iter_mut().zip(&ended.parts).for_each(|(all, part)| *all = all.max(*part));
                all.steps += ended.steps;
                all.touched |= ended.touched;
                all.harm |= ended.harm;
                if ended.harm {
                    all.note = format!("{}\n    {variation}: {}", all.note, ended.note);
                }
            }
            Ok(all)
        })
    }
}

impl Plan {
    /// Builds the probe and the solids, which all scenes of a genome share.
    fn bodies(&self) -> Result<(Object, Vec<Object>), String> {
        let made = |(index, solid): (usize, &Solid)| solid.object(&format!("object {index}"));
        let objects = self.solids.iter().enumerate().map(made).collect::<Result<_, _>>()?;
        Ok((self.probe.object("probe")?, objects))
    }

    /// Runs the scene's session, and one in an empty scene beside it.
    fn run(&self, probe: &Object, objects: &[Object]) -> Result<Ended, String> {
        let with = |scene: Scene, (solid, pose): &(usize, Pose)| scene.with(objects[*solid].clone(), *pose);
        let scene = self.placed.iter().fold(Scene::new(), with);
        let mut specification = Emulation::default().specification;
        // Large probes need a large workspace.
        specification.workspace_radius = 3.0;
        let (settings, start) = (Settings::default(), self.route.start());
        let placement = HandlePlacement::new(&settings, probe, &specification);
        let begun =
            |scene: &Scene| Driven::start((probe, scene), &specification, settings, self.rate, &start);
        let ((mut session, at), (mut empty, _)) = (begun(&scene)?, begun(&Scene::new())?);
        let placed: Vec<(&Solid, Pose)> =
            self.placed.iter().map(|(solid, pose)| (&self.solids[*solid], *pose)).collect();
        let read = placement.mesh_pose(&rounded(&at, &specification));
        let mut judge = Judge::new((self, &read), &placed, probe.clod.source.center_of_mass);
        let steps = (self.route.last().0 / PERIOD).ceil() as u64;
        for step in 1..=steps {
            let time = step as f64 * PERIOD;
            let handle = placement.device_pose(&self.route.at(time));
            let engaging = |session: &Driven| session.haptic().telemetry().events.engaging;
            let before = engaging(&empty);
            let (record, free) = (session.advance(&handle), empty.advance(&handle));
            let is_whole = engaging(&empty) == before;
            judge.take(&record, (&free, is_whole), time);
        }
        Ok(judge.end(steps))
    }
}

struct Judge<'a> {
    plan: &'a Plan,
    oracle: Oracle,
    /// The distances from the bodies beside the route.
    beside: Oracle,
    center: DVec3,
    overlap: f64,
    /// Overlap at the start, m: that of a press fit, which stays.
    fit: f64,
    /// Speeds of the probe's fastest point in the last steps, m/s, of hand and body.
    speeds: Vec<f64>,
    last: Option<(Pose, Pose)>,
    /// Time since which everything has been far away, s.
    clear: f64,
    /// Distance from the place in an empty scene at that time, m.
    behind: f64,
    touched: bool,
    finite: bool,
    largest: [Largest; NAMES.len()],
}

impl<'a> Judge<'a> {
    /// Starts with the probe where the device reads its handle.
    fn new((plan, start): (&'a Plan, &Pose), placed: &[(&Solid, Pose)], center: DVec3) -> Self {
        let mut oracle = Oracle::new(&plan.probe, placed);
        let beside = Oracle::new(&plan.probe, &placed[plan.uniform..]);
        oracle.place(start);
        let fit = oracle.overlap();
        let (low, high) = USUAL_RADIUS;
        let scale = (plan.radius / low).min(1.0).max(plan.radius / high);
        Self {
            plan,
            oracle,
            beside,
            center,
            overlap: MAX_OVERLAP * scale,
            fit,
            speeds: Vec::new(),
            last: None,
            clear: f64::NEG_INFINITY,
            behind: 0.0,
            touched: false,
            finite: true,
            largest: [Largest::default(); NAMES.len()],
        }
    }

    /// Takes a step's record and that in an empty scene, with whether all of its wrench was sent: hands here
    /// do not yield, and where one ran with the force, the session let go and raises it again from zero.
    fn take(&mut self, record: &Record, (free, is_whole): (&Record, bool), time: f64) {
        let is_finite = record.object.is_valid() && record.contact.is_finite() && record.coupling.is_finite();
        self.finite &= is_finite;
        if !is_finite {
            return;
        }
        let [sideways, overlap, drag, lag] = &mut self.largest;
        // Where the probe is held away from its route it may come to a body beside that.
        self.beside.place(&record.object);
        let along = |along: &DVec3| record.contact.force.dot(*along).abs();
        let most = self.plan.even.iter().map(along).fold(0.0, f64::max);
        if most > 0.0 && self.beside.is_beyond(NEAR * self.plan.radius) {
            sideways.take(most, MAX_SIDEWAYS, time);
        }
        self.oracle.place(&record.object);
        let deep = self.oracle.overlap();
        overlap.take(deep - self.fit, self.overlap, time);
        self.fit = self.fit.min(deep);
        self.touched |= record.contact.force != DVec3::ZERO;

        // How far the body can have moved since the query that the contact model is of.
        let moved = |from: &Pose, to: &Pose| {
            from.translation.distance(to.translation)
                + self.plan.radius * from.rotation_vector_to(to).length()
        };
        let speed = self.last.as_ref().map_or(0.0, |(object, handle)| {
            moved(object, &record.object).max(moved(handle, &record.handle)) / PERIOD
        });
        self.last = Some((record.object, record.handle));
        self.speeds.push(speed);
        let interval = (1.0 / self.plan.rate).max(PERIOD);
        let recent = (((MODEL_AGE + 1.0) * interval / PERIOD) as usize).min(self.speeds.len());
        let fastest = self.speeds[self.speeds.len() - recent..].iter().copied().fold(0.0, f64::max);
        let [here, there] = [record, free].map(|it| it.object.transform_point(self.center));
        let behind = here.distance(there);
        // Even at rest, surfaces are held apart.
        let held = HELD * self.plan.radius;
        if !self.oracle.is_beyond(held + fastest * (MODEL_AGE * interval + PERIOD)) {
            (self.clear, self.behind) = (time, behind);
        }
        if time - self.clear > SETTLING.0.max(SETTLING.1 * interval) + self.behind / COMING_BACK {
            let beyond = record.coupling.force.length() - free.coupling.force.length();
            if is_whole {
                drag.take(beyond, MAX_DRAG, time);
            }
            lag.take(behind, MAX_LAG, time);
        }
    }

    fn end(self, steps: u64) -> Ended {
        let mut note = format!("{:?}", self.plan);
        for ((name, unit), Largest { value, time, .. }) in NAMES.iter().zip(&self.largest) {
            let _ = write!(note, "; {name} {value:.3e} {unit} at {time:.3} s");
        }
        if self.oracle.unsolved > 0 {
            let _ = write!(note, "; {} distances unsolved", self.oracle.unsolved);
        }
        let parts: Vec<f64> =
            self.largest.iter().map(|it| if self.finite { it.part } else { f64::INFINITY }).collect();
        Ended {
            harm: parts.iter().any(|part| *part > 1.0),
            parts,
            steps,
            touched: self.touched,
            note,
            ..Ended::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use palpate::Wrench;

    use super::*;

    fn plans() -> impl Iterator<Item = (Genome, Plan)> {
        (0..40).flat_map(|seed| {
            (0..2).map(move |variation| {
                let genome = Genome::new(seed);
                let plan = Plan::of(&genome, variation);
                (genome, plan)
            })
        })
    }

    /// Bodies are closed, those of a genome are the same in its scenes, and no scene starts in an overlap.
    #[test]
    fn scenes_are_of_all_kinds_and_start_apart() {
        let mut kinds: Vec<Kind> = Vec::new();
        let mut most = 0;
        for (genome, plan) in plans() {
            let again = Plan::of(&genome, 5);
            assert_eq!(again.probe.vertices, plan.probe.vertices, "{genome}");
            assert_eq!(again.solids.len(), plan.solids.len(), "{genome}");
            for (one, two) in again.solids.iter().zip(&plan.solids) {
                assert_eq!(one.vertices, two.vertices, "{genome}");
            }
            for solid in plan.solids.iter().chain([&plan.probe]) {
                let report = solid.mesh().expect("a mesh").validate();
                assert!(report.is_solid(), "{genome}, {plan:?}: {report:?}");
            }
            assert!((1..=60).contains(&plan.placed.len()), "{genome}: {plan:?}");
            most = most.max(plan.placed.len());
            let placed: Vec<(&Solid, Pose)> =
                plan.placed.iter().map(|(solid, pose)| (&plan.solids[*solid], *pose)).collect();
            let mut oracle = Oracle::new(&plan.probe, &placed);
            oracle.place(&plan.route.start());
            assert_eq!(oracle.overlap(), 0.0, "{genome}: {plan:?}");
            kinds.push(plan.kind);
        }
        assert!(Kind::ALL.iter().all(|kind| kinds.contains(kind)), "{kinds:?}");
        assert!(most > 20, "{most}");
    }

    /// A body that follows its hand above the floor does nothing wrong, and whatever is changed is found.
    #[test]
    fn what_feels_wrong_is_found() {
        let (_, plan) = plans().find(|(_, plan)| plan.kind == Kind::Floor).expect("a floor");
        let placed: Vec<(&Solid, Pose)> =
            plan.placed.iter().map(|(solid, pose)| (&plan.solids[*solid], *pose)).collect();
        let pose = plan.route.start();
        let free = Record {
            time: 0.0,
            device: pose,
            handle: pose,
            object: pose,
            coupling: Wrench::ZERO,
            contact: Wrench::ZERO,
            depth: 0.0,
            contacts: 0,
            model_age: 0.0,
        };
        let judged_beside = |is_whole: bool, change: &dyn Fn(&mut Record)| {
            let mut judge = Judge::new((&plan, &pose), &placed, DVec3::ZERO);
            let mut record = free;
            change(&mut record);
            (1..500).for_each(|step| judge.take(&record, (&free, is_whole), f64::from(step) * PERIOD));
            judge.end(499).parts
        };
        let judged = |change: &dyn Fn(&mut Record)| judged_beside(true, change);
        let up = plan.even[0].cross(plan.even[1]);
        let lower = plan.route.stops().nth(2).copied().unwrap_or_default();
        assert_eq!(judged(&|_| {}), [0.0; 4]);
        let sideways = judged(&|record| record.contact.force = 3.0 * up + 0.02 * plan.even[1]);
        assert!(sideways[0] > 1.9 && sideways[1..] == [0.0; 3], "{sideways:?}");
        let inside = judged(&|record| record.object = lower);
        assert!(inside[1] > 1.0 && inside[0] == 0.0, "{inside:?}");
        // What starts in an overlap may stay in it, but not come back to it.
        let back = |through: &[Pose]| {
            let mut judge = Judge::new((&plan, &lower), &placed, DVec3::ZERO);
            for object in through {
                judge.take(&Record { object: *object, ..free }, (&free, true), PERIOD);
            }
            judge.end(through.len() as u64).parts[1]
        };
        assert_eq!(back(&[lower, lower]), 0.0);
        assert_eq!(back(&[lower, pose, lower]), inside[1]);
        let drag = judged(&|record| record.coupling.force = 0.1 * up);
        assert!(drag[2] > 1.9 && drag[3] == 0.0, "{drag:?}");
        assert_eq!(judged_beside(false, &|record| record.coupling.force = 0.1 * up), [0.0; 4]);
        let lag = judged(&|record| record.object.translation += 1e-3 * up);
        assert!(lag[3] > 1.9 && lag[..3] == [0.0; 3], "{lag:?}");
        let broken = judged(&|record| record.object.translation.x = f64::NAN);
        assert!(broken.iter().all(|part| *part == f64::INFINITY), "{broken:?}");
    }
}
