//! A query and its clustering allocate nothing after a pass over the same poses.

use crate::solids::{Kind, clusters, hierarchy, singles, star};
use allocation_counter::measure;
use palpate_collide::{Clustering, ContactQuery, QuerySettings, Shape};
use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};

#[test]
fn a_warm_query_does_not_allocate() {
    let bumpy = star(3, |v| 1.0 + 0.12 * (7.0 * v.x).sin() * (6.0 * v.y + 1.0).sin());
    let ball = star(3, |v| 1.0 + 0.2 * v.x);
    assert!(measure(|| drop(std::hint::black_box(vec![1u8]))).count_total > 0, "the counter counts");
    let (loose, _) = hierarchy(&bumpy, &clusters(&bumpy, 4), Kind::Loose);
    let (fine, _) = hierarchy(&bumpy, &singles(&bumpy), Kind::Contained);
    let (whole, _) = hierarchy(&ball, &[(0..ball.triangles().len() as u32).collect()], Kind::Contained);
    let (patches, _) = hierarchy(&ball, &clusters(&ball, 30), Kind::Contained);
    let (open, _) = hierarchy(&bumpy, &clusters(&bumpy, 4), Kind::Open);
    for (probe, scene) in
        [(&loose, &fine), (&whole, &fine), (&patches, &loose), (&patches, &patches), (&open, &fine)]
    {
        let mut query = ContactQuery::new(&Shape::new(probe.clone()), &Shape::new(scene.clone()));
        let mut clustering = Clustering::new(5);
        let settings =
            [0.0, 0.03].map(|error| QuerySettings { error: error.into(), ..QuerySettings::new(0.1) });
        let mut pass = || {
            let mut contacts = 0;
            for step in 0..40 {
                let t = f64::from(step) / 40.0;
                let pose = Pose::new(DVec3::new(2.4 - t, 0.3 * t, 0.1), DQuat::from_rotation_y(t));
                for settings in &settings {
                    let outcome = query.run(&pose, &Pose::IDENTITY, settings).unwrap();
                    clustering.run(query.contacts(), settings.tolerance, &pose);
                    contacts += outcome.contacts;
                    let much = QuerySettings { tolerance: 100.0, ..*settings };
                    assert!(query.run(&pose, &Pose::IDENTITY, &much).is_err());
                }
            }
            contacts
        };
        let warm = pass();
        assert_eq!(measure(|| assert_eq!(pass(), warm)).count_total, 0);
        assert!(warm > 100, "{warm}");
    }
}
