//! Views from which objects are drawn.

use palpate::glam::DVec3;
use palpate::models::Model;

use crate::raster::View;

/// Returns the view that shows a built-in model best. Models stand with z upwards.
pub fn of_model(model: Model) -> View {
    let (azimuth, elevation) = match model {
        Model::LowerJaw => (65.0, 38.0),
        Model::UpperJaw => (65.0, -32.0),
        Model::BallJointBall | Model::BallJointSocket => (-60.0, 20.0),
        Model::GolfClub => (-60.0, 20.0),
        Model::Cup | Model::CupLow => (-55.0, 28.0),
        Model::Spoon | Model::SpoonLow => (-75.0, 38.0),
        Model::Block => (35.0, 25.0),
        Model::Gear => (-60.0, 40.0),
        Model::Hammer => (-70.0, 25.0),
        Model::CadPart => (-140.0, 32.0),
        Model::File => (-90.0, 62.0),
        Model::Torus => (-70.0, 40.0),
        Model::Stylus => (-60.0, 20.0),
        Model::Plate | Model::ForcepsJaw | Model::Nut | Model::Hole => (-60.0, 30.0),
        Model::Bolt | Model::Peg => (-60.0, 15.0),
        Model::GolfBall | Model::Ellipsoid => (-60.0, 25.0),
    };
    // Long objects fill the picture if they lie across it.
    let roll: f64 = match model {
        Model::Hammer => 55.0,
        Model::File | Model::Spoon | Model::SpoonLow => -24.0,
        _ => 0.0,
    };
    View { roll: roll.to_radians(), ..View::from_degrees(azimuth, elevation) }
}

/// Returns a three-quarter view from above of an object, given its points (m), with z upwards. Of the
/// directions around it, the one with the smallest depth is chosen, so that the broadest side is visible.
pub fn around<'p>(points: impl IntoIterator<Item = &'p DVec3> + Clone) -> View {
    const STEP: f64 = 15.0;
    const ELEVATION: f64 = 30.0;
    // Directions along axes are left out, since a part made of boxes would show only one side.
    let azimuths = (0..24).map(|step| STEP * f64::from(step) - 60.0).filter(|azimuth| azimuth % 90.0 != 0.0);
    let views = azimuths.map(|azimuth| View::from_degrees(azimuth, ELEVATION));
    let depth = |view: &View| {
        let backward = view.to_camera().row(2);
        let (low, high) = points
            .clone()
            .into_iter()
            .map(|point| backward.dot(*point))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
        high - low
    };
    // The first of equal ones, as for a ball.
    views.min_by(|a, b| depth(a).total_cmp(&depth(b))).unwrap_or(View::from_degrees(-60.0, ELEVATION))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broad_side_of_a_plate_is_visible() {
        // A plate in the plane through z and the horizontal direction at 30°: its normal is at 120° or at
        // −60°.
        let (sin, cos) = 30.0_f64.to_radians().sin_cos();
        let corners = [(-1.0, 0.0), (1.0, 0.0), (1.0, 0.3), (-1.0, 0.3)];
        let plate = corners.map(|(along, up)| DVec3::new(cos * along, sin * along, up));
        let azimuth = around(&plate).azimuth.to_degrees();
        assert!((azimuth + 60.0).abs() < 1e-9 || (azimuth - 120.0).abs() < 1e-9, "{azimuth}");
    }
}
