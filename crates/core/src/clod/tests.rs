use glam::DMat3;
use rand::{RngExt, SeedableRng, rngs::StdRng};

use super::*;

fn ball(random: &mut StdRng) -> DVec3 {
    loop {
        let p = DVec3::from_array([0; 3].map(|_| random.random_range(-1.0..1.0)));
        if p.length_squared() <= 1.0 {
            return p;
        }
    }
}

/// A hierarchy that is valid, but describes no object: random points as hulls.
fn random_hierarchy(seed: u64, leaves: u32) -> Parts {
    let random = &mut StdRng::seed_from_u64(seed);
    // From the leaves to the root: how many children each node of the coarser level has.
    let mut families: Vec<Vec<u32>> = Vec::new();
    let mut count = leaves;
    while count > 1 || families.is_empty() {
        let mut remaining = count;
        let mut sizes = Vec::new();
        while remaining > 0 {
            let size = if count <= 3 { count } else { random.random_range(1..=3).min(remaining) };
            sizes.push(size);
            remaining -= size;
        }
        count = sizes.len() as u32;
        families.push(sizes);
    }
    let mut clod = Parts {
        levels: vec![],
        nodes: vec![],
        vertices: vec![],
        support_areas: vec![],
        triangles: vec![],
        source: Source {
            vertices: 3 * leaves,
            triangles: 4 * leaves,
            solid: true,
            tolerance: 1e-6,
            bounding_radius: 2.0,
            center: DVec3::new(0.1, -0.0, 3.0),
            volume: 0.7,
            center_of_mass: DVec3::new(0.2, 0.1, 3.1),
            unit_inertia: DMat3::from_diagonal(DVec3::new(1.0, 1.5, 2.0)),
        },
    };
    let depth = families.len();
    let mut sizes_of_level = vec![leaves];
    sizes_of_level.extend(families.iter().map(|sizes| sizes.len() as u32));
    for level in (0..=depth).rev() {
        let start = clod.nodes.len() as u32;
        let end = start + sizes_of_level[level];
        let free = level > 0 && level == depth;
        clod.levels.push(Level {
            nodes: start..end,
            triangles: 40,
            resolution: 10.0 / (level + 1) as f64,
            free,
        });
        let mut next_child = end;
        for i in 0..sizes_of_level[level] {
            let family = if level == 0 { 0 } else { families[level - 1][i as usize] };
            let children = if level == 0 { 0..0 } else { next_child..next_child + family };
            next_child += family;
            let (first_vertex, first_triangle) = (clod.vertices.len() as u32, clod.triangles.len() as u32);
            let (center, radius) = (ball(random), random.random_range(0.1..1.0));
            let (size, added) = (random.random_range(3..8u32), random.random_range(0..3));
            for _ in 0..added + size {
                clod.vertices.push(center + radius * ball(random));
                clod.support_areas.push(random.random_range(0.0..1.0));
            }
            for _ in 0..if free { 0 } else { random.random_range(1..4) } {
                let a = random.random_range(0..size);
                clod.triangles.push([a, (a + 1) % size, (a + 2) % size]);
            }
            clod.nodes.push(Node {
                parent: NO_NODE,
                children,
                level: level as u32,
                vertices: first_vertex + added..clod.vertices.len() as u32,
                extreme: random.random_range(1..=size),
                added,
                triangles: first_triangle..clod.triangles.len() as u32,
                center,
                radius,
                deviation: random.random_range(0.0..0.1),
                hausdorff: random.random_range(0.0..0.1),
                contained: random.random(),
                all_real: random.random(),
            });
        }
    }
    clod.levels.reverse();
    for parent in 0..clod.nodes.len() {
        for child in clod.nodes[parent].children.clone() {
            clod.nodes[child as usize].parent = parent as u32;
        }
    }
    clod.validate().expect("the test's own hierarchy is valid");
    clod
}

fn bytes_of(clod: &Parts) -> Vec<u8> {
    let mut bytes = Vec::new();
    clod.write(&mut bytes).unwrap();
    bytes
}

/// Replaces the stored checksum by that of the body.
fn reseal(bytes: &mut [u8]) {
    let checksum = crc32fast::hash(&bytes[24..]);
    bytes[20..24].copy_from_slice(&checksum.to_le_bytes());
}

/// Walks the hierarchy as a query does, with plain indexing, which panics where an index is out of range.
/// Returns the number of nodes visited.
fn walk(clod: &Parts) -> usize {
    let mut visited = vec![false; clod.nodes.len()];
    let mut stack = vec![Parts::ROOT];
    while let Some(index) = stack.pop() {
        assert!(!std::mem::replace(&mut visited[index as usize], true), "node {index} visited twice");
        let node = &clod.nodes[index as usize];
        let level = &clod.levels[node.level as usize];
        assert!(level.nodes.contains(&index));
        assert!(!clod.extreme(node).is_empty());
        assert_eq!(clod.hull(node).len(), clod.support_areas(node).len());
        assert_eq!(clod.patch(node).is_empty(), level.free);
        for corners in clod.patch(node) {
            assert!(corners.iter().all(|v| clod.hull(node)[*v as usize].is_finite()));
        }
        assert!(node.radius >= 0.0 && node.deviation >= 0.0 && node.hausdorff >= 0.0);
        for (child, index) in clod.children(node).iter().zip(node.children.clone()) {
            assert_eq!(child.level + 1, node.level);
            assert_eq!(clod.nodes[child.parent as usize], *node);
            stack.push(index);
        }
    }
    visited.iter().filter(|v| **v).count()
}

#[test]
fn a_hierarchy_survives_writing_and_reading() {
    for (seed, leaves) in [(1, 1), (2, 2), (3, 30), (4, 5000)] {
        let clod = random_hierarchy(seed, leaves);
        let bytes = bytes_of(&clod);
        let read = Parts::read(&*bytes).unwrap();
        assert_eq!(read, clod);
        assert_eq!(bytes_of(&read), bytes);
        assert_eq!(walk(&read), clod.nodes.len());
        assert_eq!(read.leaves().len(), leaves as usize);
        assert_eq!(read.bounding_radius(), 2.0);
    }
}

#[test]
fn the_layout_is_as_documented() {
    let clod = random_hierarchy(5, 9);
    let bytes = bytes_of(&clod);
    assert_eq!(&bytes[..8], b"palpclod");
    assert_eq!(bytes[8..12], 3u32.to_le_bytes());
    assert_eq!(bytes[12..20], (bytes.len() as u64 - 24).to_le_bytes());
    assert_eq!(bytes[24..28], (clod.levels.len() as u32).to_le_bytes());
    assert_eq!(bytes[28..32], (clod.nodes.len() as u32).to_le_bytes());
    let [.., last] = clod.triangles.last().unwrap();
    assert_eq!(bytes[bytes.len() - 4..], last.to_le_bytes());
    let levels_at = 24 + 16 + 156;
    assert_eq!(bytes[24 + 16 + 12..24 + 16 + 20], 1e-6f64.to_le_bytes());
    let nodes_at = levels_at + 24 * clod.levels.len();
    assert_eq!(bytes[nodes_at..nodes_at + 4], NO_NODE.to_le_bytes());
    let vertices_at = nodes_at + 92 * clod.nodes.len();
    assert_eq!(bytes[vertices_at..vertices_at + 8], clod.vertices[0].x.to_le_bytes());
}

/// Files that were written before hierarchies held their tolerance.
#[test]
fn an_older_version_is_refused() {
    let mut bytes = bytes_of(&random_hierarchy(5, 9));
    bytes[8..12].copy_from_slice(&2u32.to_le_bytes());
    let error = Parts::read(&*bytes).unwrap_err();
    assert!(matches!(error, ClodError::Version { found: 2 }), "{error}");
    assert!(error.to_string().contains("build it again"), "{error}");
}

#[test]
fn reading_stops_at_the_end() {
    let mut bytes = bytes_of(&random_hierarchy(6, 10));
    bytes.extend(b"next");
    let mut rest = &*bytes;
    Parts::read(&mut rest).unwrap();
    assert_eq!(rest, b"next");
}

#[test]
fn every_prefix_is_refused() {
    let bytes = bytes_of(&random_hierarchy(7, 12));
    for length in 0..bytes.len() {
        let error = Parts::read(&bytes[..length]).unwrap_err();
        match error {
            ClodError::NotClod { .. } if length == 0 => {}
            ClodError::Truncated { found, expected } => {
                assert_eq!(found, length as u64);
                assert!(expected == bytes.len() as u64 || length < 24);
            }
            other => panic!("prefix of {length} bytes: {other}"),
        }
    }
}

#[test]
fn every_damaged_byte_is_noticed() {
    let bytes = bytes_of(&random_hierarchy(8, 12));
    for position in 0..bytes.len() {
        for flip in [0x01, 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[position] ^= flip;
            assert!(Parts::read(&*damaged).is_err(), "byte {position} ^ {flip:#x}");
        }
    }
}

/// With a corrected checksum, only validation protects a query from hostile data.
#[test]
fn accepted_hierarchies_can_be_walked() {
    const SEED: u64 = 9;
    let bytes = bytes_of(&random_hierarchy(SEED, 12));
    let random = &mut StdRng::seed_from_u64(SEED);
    let (mut accepted, mut refused) = (0, 0);
    let mut attempt = |damaged: &mut [u8]| {
        reseal(damaged);
        match Parts::read(&*damaged) {
            Ok(clod) => {
                assert_eq!(walk(&clod), clod.nodes.len(), "seed {SEED}");
                assert_eq!(bytes_of(&clod), damaged);
                accepted += 1;
            }
            Err(_) => refused += 1,
        }
    };
    for position in 24..bytes.len() {
        for value in [0, 1, 0x7f, 0xff] {
            let mut damaged = bytes.clone();
            damaged[position] = value;
            attempt(&mut damaged);
        }
    }
    for _ in 0..20_000 {
        let mut damaged = bytes.clone();
        for _ in 0..random.random_range(1..4) {
            // Whole words, some of them indices in range.
            let word = 24 + 4 * random.random_range(0..(damaged.len() - 24) / 4);
            let value = if random.random() { random.random_range(0..40) } else { random.random::<u32>() };
            damaged[word..word + 4].copy_from_slice(&value.to_le_bytes());
        }
        attempt(&mut damaged);
    }
    assert!(accepted > 1000 && refused > 1000, "{accepted} accepted, {refused} refused");
}

#[test]
fn hostile_lengths_allocate_nothing() {
    let bytes = bytes_of(&random_hierarchy(10, 12));
    // The header claims 2³² − 1 nodes and vertices, half a terabyte: to allocate it would abort the test.
    for (levels, nodes, vertices, triangles) in
        [(3, u32::MAX, 5, 5), (3, 5, u32::MAX, 5), (u32::MAX, u32::MAX, u32::MAX, u32::MAX)]
    {
        let mut hostile = bytes.clone();
        let body = 16
            + 156
            + 24 * u64::from(levels)
            + 92 * u64::from(nodes)
            + 32 * u64::from(vertices)
            + 12 * u64::from(triangles);
        hostile[12..20].copy_from_slice(&body.to_le_bytes());
        for (i, count) in [levels, nodes, vertices, triangles].into_iter().enumerate() {
            hostile[24 + 4 * i..28 + 4 * i].copy_from_slice(&count.to_le_bytes());
        }
        let error = Parts::read(&*hostile).unwrap_err();
        assert!(
            matches!(error, ClodError::Truncated { found, .. } if found == bytes.len() as u64),
            "{error}"
        );
    }
    for length in [0, 1, 171, u64::MAX, u64::MAX - 24] {
        let mut hostile = bytes.clone();
        hostile[12..20].copy_from_slice(&length.to_le_bytes());
        let error = Parts::read(&*hostile).unwrap_err();
        assert!(matches!(error, ClodError::Counts { found, .. } if found == length), "{error}");
    }
}

#[test]
fn files_are_saved_and_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("object.clod");
    let clod = random_hierarchy(11, 20);
    clod.save(&path).unwrap();
    assert_eq!(Parts::load(&path).unwrap(), clod);

    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, [&bytes[..], b"x"].concat()).unwrap();
    assert!(matches!(Parts::load(&path), Err(ClodError::Overlong { .. })));
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(matches!(Parts::load(&path), Err(ClodError::Truncated { .. })));
    std::fs::write(&path, "o block\nv 0 0 0\nv 1 0 0\n").unwrap();
    assert!(matches!(Parts::load(&path), Err(ClodError::NotClod { .. })));
    let missing = folder.path().join("missing.clod");
    let message = Parts::load(&missing).unwrap_err().to_string();
    assert!(message.contains("missing.clod"), "{message}");
    assert!(Parts::load(folder.path()).is_err());
}

#[test]
fn an_invalid_hierarchy_is_not_written() {
    let mut clod = random_hierarchy(12, 5);
    clod.nodes[1].radius = f64::NAN;
    let mut bytes = Vec::new();
    assert!(matches!(clod.write(&mut bytes), Err(ClodError::Invalid { .. })));
    assert!(bytes.is_empty());
}

/// Breaks one invariant at a time.
#[test]
fn each_broken_invariant_is_named() {
    type Break = fn(&mut Parts);
    let breaks: &[(&str, &str, Break)] = &[
        ("source", "bounding radius", |c| c.source.bounding_radius = 0.0),
        ("source", "bounding radius", |c| c.source.bounding_radius = f64::INFINITY),
        ("source", "tolerance", |c| c.source.tolerance = -1e-9),
        ("source", "tolerance", |c| c.source.tolerance = 1.5),
        ("source", "tolerance", |c| c.source.tolerance = f64::NAN),
        ("source", "centre", |c| c.source.center.y = f64::NAN),
        ("source", "centre", |c| c.source.center_of_mass.z = 1e60),
        ("source", "volume", |c| c.source.volume = -1.0),
        ("source", "inertia", |c| c.source.unit_inertia.x_axis.x = 0.0),
        ("source", "inertia", |c| c.source.unit_inertia.x_axis.y = 0.1),
        ("source", "inertia", |c| c.source.unit_inertia.z_axis.z = f64::NAN),
        ("levels", "none", |c| c.levels.clear()),
        ("levels", "hold", |c| c.nodes.push(c.nodes[5].clone())),
        ("level 0", "resolution", |c| c.levels[0].resolution = f64::NAN),
        ("level 0", "free", |c| c.levels.iter_mut().for_each(|level| level.free = true)),
        ("level 2", "finer level is", |c| c.levels[1].free = true),
        ("level 0", "its nodes", |c| c.levels[0].nodes.start += 1),
        ("level 0", "its nodes", |c| c.levels[0].nodes.end += 1),
        ("level 1", "its nodes", |c| c.levels[1].nodes.end = c.levels[1].nodes.start),
        ("level 4", "root alone", |c| {
            c.levels[4].nodes.end = 3;
            c.levels[3].nodes = 3..c.levels[3].nodes.end;
        }),
        ("support areas", "there are", |c| c.support_areas.truncate(1)),
        ("hull vertices", "use", |c| {
            c.vertices.push(DVec3::ZERO);
            c.support_areas.push(0.0);
        }),
        ("patch triangles", "use", |c| c.triangles.push([0, 1, 2])),
        ("node 0", "root", |c| c.nodes[0].parent = 0),
        ("node 0", "level", |c| c.nodes[0].level = 77),
        ("node 2", "level", |c| c.nodes[2].level = 0),
        ("node 0", "children", |c| c.nodes[0].children = 1..1),
        ("node 0", "children", |c| c.nodes[0].children.end += 1),
        ("node 0", "child", |c| c.nodes[1].parent = 1),
        ("node 4", "parent", |c| c.nodes[1].children.end -= 1),
        ("node 20", "leaf", |c| c.nodes[20].children = 19..20),
        ("node 20", "leaf", |c| c.nodes[20].children = u32::MAX..u32::MAX),
        ("node 3", "hull vertices", |c| c.nodes[3].vertices.start -= 1),
        ("node 3", "hull vertices", |c| c.nodes[3].vertices.end = u32::MAX),
        ("node 3", "hull vertices", |c| c.nodes[3].vertices.end = 0),
        ("node 3", "triangles", |c| c.nodes[3].triangles.end = u32::MAX),
        ("node 3", "hull vertices", |c| c.nodes[3].added += 1),
        ("node 3", "hull vertices", |c| c.nodes[3].added = u32::MAX),
        ("node 3", "extreme", |c| c.nodes[3].extreme = 0),
        ("node 3", "extreme", |c| c.nodes[3].extreme = 99),
        ("node 0", "no triangles", |c| c.levels.last_mut().unwrap().free = false),
        ("node 1", "three of", |c| c.triangles[0] = [0, 1, 99]),
        ("node 1", "three of", |c| c.triangles[0] = [0, 1, 0]),
        ("node 3", "centre", |c| c.nodes[3].center.x = f64::NEG_INFINITY),
        ("node 3", "radius", |c| c.nodes[3].radius = -1e-9),
        ("node 3", "deviation", |c| c.nodes[3].deviation = f64::NAN),
        ("node 3", "h is", |c| c.nodes[3].hausdorff = f64::INFINITY),
        ("node 3", "bounding sphere", |c| c.nodes[3].radius = 0.0),
        ("node 0", "bounding sphere", |c| c.vertices[0].z = f64::NAN),
        ("node 0", "support area", |c| c.support_areas[0] = -1.0),
        ("node 0", "support area", |c| c.support_areas[0] = f64::NAN),
    ];
    let sound = random_hierarchy(13, 12);
    // The numbers that the cases above assume.
    assert_eq!(sound.levels.len(), 5);
    assert_eq!(sound.levels[4].nodes, 0..1);
    assert!(sound.levels[3].nodes.end > 2 && sound.levels[0].nodes.start <= 20 && sound.nodes.len() > 20);
    assert!(sound.nodes[1].children.end == 5 && sound.nodes[3].level > 0, "{:?}", sound.nodes[1]);
    for (place, what, damage) in breaks {
        let mut clod = sound.clone();
        damage(&mut clod);
        let message = clod.validate().unwrap_err().to_string();
        assert!(message.contains(place) && message.contains(what), "{place}, {what}: {message}");
    }
}

/// A hierarchy made larger by a factor, and then moved.
fn placed(parts: &Parts, factor: f64, by: DVec3) -> Parts {
    let mut parts = parts.scaled(factor).expect("a factor");
    parts.source.center += by;
    parts.nodes.iter_mut().for_each(|node| node.center += by);
    parts.vertices.iter_mut().for_each(|vertex| *vertex += by);
    // Rounding of the coordinates.
    parts.nodes.iter_mut().for_each(|node| node.radius += 4.0 * f64::EPSILON * by.length());
    parts
}

#[test]
fn packed_nodes_keep_their_bounds() {
    let sound = random_hierarchy(14, 300);
    let mut loosened = 0;
    for (factor, by) in
        [(1.0, 0.0), (1e-45, 0.0), (1e45, 0.0), (1e-3, 7.0), (1.0, 1e9), (1e-6, 1e3), (12.3, -0.01)]
    {
        let parts = placed(&sound, factor, by * DVec3::new(1.0, -2.0, 0.3));
        let packed = Clod::pack(&parts).unwrap();
        let size = parts.source.bounding_radius;
        for (node, own) in parts.nodes.iter().zip(packed.nodes()) {
            let aside = node.center.distance(own.center);
            assert!(own.radius >= node.radius + aside && own.hausdorff >= node.hausdorff);
            assert!(own.deviation >= node.deviation);
            let rounding = 2.0 * f64::EPSILON * by.abs();
            assert!(own.radius - node.radius <= 1e-6 * size + rounding, "{factor}, {by}");
            assert!(own.hausdorff <= node.hausdorff * (1.0 + 1e-6), "{factor}, {by}");
            assert!(own.deviation <= node.deviation * (1.0 + 1e-6), "{factor}, {by}");
            loosened += usize::from(own.radius > node.radius);
            let same = Node {
                center: node.center,
                radius: node.radius,
                deviation: node.deviation,
                hausdorff: node.hausdorff,
                children: if own.children.is_empty() { node.children.clone() } else { own.children.clone() },
                ..own.clone()
            };
            assert_eq!(same, *node);
            assert!(packed.hull(&own).iter().eq(parts.hull(node)));
            assert!(packed.extreme(&own).iter().eq(parts.extreme(node)));
            assert!(packed.bounding_hull(&own).iter().eq(parts.bounding_hull(node)));
            assert!(packed.support_areas(&own).iter().eq(parts.support_areas(node).iter().copied()));
            assert!(packed.bounding_areas(&own).iter().eq(parts.bounding_areas(node).iter().copied()));
            assert!(packed.patch(&own).iter().eq(parts.patch(node).iter().copied()));
            assert!(
                packed.children(&own).eq(packed
                    .nodes()
                    .filter(|child| { child.level + 1 == own.level && packed.node(child.parent) == own }))
            );
        }
    }
    assert!(loosened > 1000, "{loosened}");
}

#[test]
fn packing_again_changes_nothing() {
    for (seed, factor) in [(15, 1.0), (16, 1e-7), (17, 3e12)] {
        let packed = Clod::pack(&random_hierarchy(seed, 200).scaled(factor).unwrap()).unwrap();
        assert_eq!(Clod::pack(&packed.parts()).unwrap(), packed);
        let mut bytes = Vec::new();
        packed.write(&mut bytes).unwrap();
        assert_eq!(Clod::read(&*bytes).unwrap(), packed);
        assert_eq!(packed.scaled(4.0).and_then(|scaled| scaled.scaled(0.25)).unwrap(), packed);
    }
}

#[test]
fn equal_points_are_packed_once() {
    let mut parts = random_hierarchy(18, 100);
    let different = Clod::pack(&parts).unwrap();
    assert_eq!(different.vertices.len(), parts.vertices.len());
    // Every hull gets the first point of all, and half of them its area.
    let (point, area) = (parts.vertices[0], parts.support_areas[0]);
    for node in &mut parts.nodes {
        parts.vertices[node.vertices.start as usize] = point;
        node.radius += point.distance(node.center);
    }
    let shared = Clod::pack(&parts).unwrap();
    let repeated = parts.nodes.len();
    assert_eq!(shared.vertices.len(), parts.vertices.len(), "the areas differ");
    for node in &parts.nodes {
        parts.support_areas[node.vertices.start as usize] = area;
    }
    let shared_areas = Clod::pack(&parts).unwrap();
    assert!(shared_areas.vertices.len() + repeated <= parts.vertices.len() + 2);
    assert!(shared_areas.total_bytes() < shared.total_bytes());
    assert_eq!(shared_areas.parts().vertices, parts.vertices);
    assert_eq!(shared_areas.parts().support_areas, parts.support_areas);
}

#[test]
fn triangles_of_any_hull_are_packed() {
    for size in [256u32, 257, 65_536, 65_537] {
        let mut parts = random_hierarchy(19, 1);
        let leaf = parts.nodes.len() - 1;
        let node = &mut parts.nodes[leaf];
        parts.vertices.truncate(node.vertices.start as usize);
        parts.vertices.extend((0..size).map(|_| node.center));
        node.vertices.end = node.vertices.start + size;
        node.extreme = 1;
        parts.support_areas.resize(parts.vertices.len(), 0.25);
        parts.triangles.truncate(node.triangles.start as usize);
        parts.triangles.extend([[0, 1, size - 1], [size - 1, size - 2, 0]]);
        node.triangles.end = node.triangles.start + 2;
        let packed = Clod::pack(&parts).unwrap();
        assert!(packed.parts().triangles == parts.triangles, "{size}");
        assert_eq!(packed.hull(packed.node(leaf as u32)).len(), size as usize);
    }
}

#[test]
fn a_node_that_cannot_be_packed_is_named() {
    let mut far = random_hierarchy(20, 12);
    far.source.bounding_radius = 1e-40;
    // All its hull vertices are at its centre, so that they lie within its bounding sphere.
    far.nodes[3].center = DVec3::X * 1e20;
    let range = far.nodes[3].vertices.start - far.nodes[3].added..far.nodes[3].vertices.end;
    range.for_each(|vertex| far.vertices[vertex as usize] = DVec3::X * 1e20);
    far.nodes.iter_mut().for_each(|node| node.radius += 10.0);
    far.validate().expect("valid");
    let message = Clod::pack(&far).unwrap_err().to_string();
    assert!(message.contains("node") && message.contains("too large"), "{message}");

    let mut crossed = random_hierarchy(21, 30);
    let level = &crossed.levels[2].nodes;
    let (one, other) = (level.start as usize, level.start as usize + 1);
    // The two nodes swap their children.
    let swapped = crossed.nodes[one].children.clone();
    let with = crossed.nodes[other].children.clone();
    for child in swapped.clone() {
        crossed.nodes[child as usize].parent = other as u32;
    }
    for child in with.clone() {
        crossed.nodes[child as usize].parent = one as u32;
    }
    (crossed.nodes[one].children, crossed.nodes[other].children) = (with, swapped);
    let message = Clod::pack(&crossed).unwrap_err().to_string();
    assert!(message.contains("should begin at"), "{message}");
}
