#![allow(missing_docs, clippy::all, clippy::print_stdout, clippy::print_stderr)]
use palpate_benches::scenarios;
use std::io::Write as _;
fn main() {
    std::fs::create_dir_all("/tmp/exact").unwrap();
    for name in std::env::args().skip(1) {
        let Some(s) = scenarios::open(&name).unwrap() else { println!("{name} absent"); continue };
        for (which, body) in [("probe", &s.probe), ("scene", &s.scene)] {
            let file = format!("/tmp/exact/{name}-{which}");
            body.object.clod.save(std::path::Path::new(&format!("{file}.clod"))).unwrap();
            let mut out = std::io::BufWriter::new(std::fs::File::create(format!("{file}.mesh")).unwrap());
            out.write_all(&(body.mesh.vertices().len() as u64).to_le_bytes()).unwrap();
            out.write_all(&(body.mesh.triangles().len() as u64).to_le_bytes()).unwrap();
            for v in body.mesh.vertices() { for x in v.to_array() { out.write_all(&x.to_le_bytes()).unwrap(); } }
            for t in body.mesh.triangles() { for x in t { out.write_all(&x.to_le_bytes()).unwrap(); } }
        }
        let mut out = std::io::BufWriter::new(std::fs::File::create(format!("/tmp/exact/{name}.poses")).unwrap());
        out.write_all(&s.tolerance.to_le_bytes()).unwrap();
        out.write_all(&s.probe.object.bounding_radius().to_le_bytes()).unwrap();
        out.write_all(&(s.poses.len() as u64).to_le_bytes()).unwrap();
        for p in &s.poses { for x in p.translation.to_array().into_iter().chain(p.rotation.to_array()) { out.write_all(&x.to_le_bytes()).unwrap(); } }
        println!("{name}: {} poses", s.poses.len());
    }
}
