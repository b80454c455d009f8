//! Layout of a log in the viewer.

use re_sdk::blueprint::{
    Blueprint, ContainerLike, Horizontal, Spatial3DView, TimePanel, TimeSeriesView, Vertical,
};

use crate::TIMELINE;

/// Returns a layout with the world beside plots of forces, torques, depth and contacts, on one time axis. For
/// [`with_default_blueprint`](re_sdk::RecordingStreamBuilder::with_default_blueprint) of the stream that a
/// [`SessionLog`](crate::SessionLog) writes to.
pub fn layout() -> Blueprint {
    let plots = [
        ("force on the grasped object, N", "contact/force"),
        ("torque on the grasped object, N·m", "contact/torque"),
        ("force sent to the device, N", "device/force"),
        ("depth, m", "depth"),
        ("contacts", "contacts"),
    ];
    let plots = plots.map(|(name, entity)| TimeSeriesView::new(name).with_origin(entity).into());
    let world = Spatial3DView::new("world").with_origin("world").into();
    let columns: [ContainerLike; 2] = [world, Vertical::new(plots).into()];
    Blueprint::new(Horizontal::new(columns).with_column_shares([3.0, 2.0]))
        .with_time_panel(TimePanel::new().with_timeline(TIMELINE))
}
