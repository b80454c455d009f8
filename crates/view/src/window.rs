//! Window of a session: the picture of its scene, and a hand that the mouse moves.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use eframe::egui_wgpu::RenderState;
use eframe::{CreationContext, NativeOptions, egui};
use egui::{
    Color32, ColorImage, PointerButton, Response, RichText, Sense, Ui, ViewportBuilder, ViewportCommand,
};
use egui_plot::{Line, Plot, PlotPoints};
use palpate::device::Steering;
use palpate::glam::{DQuat, DVec3};
use palpate::{ContactMonitor, HandlePlacement, HapticRenderer, Object, Pose, Record, Scene, Session};
use palpate_report::{COLUMN, Live};

use crate::camera::Camera;
use crate::painter::{MeshOnGpu, Painter};
use crate::picture::{LevelColor, Picture, mesh_corners};

/// Time between two drawings.
const FRAME: Duration = Duration::from_millis(33);
/// Rotation of the hand for a drag over the picture's height, rad.
const TURN: f64 = 3.0;
/// Logarithm of the zoom factor per point of the wheel.
const WHEEL: f64 = 2e-3;
/// Sizes of the window, of the panel beside the picture, and of its plots and swatches, points.
const SIZE: [f32; 2] = [1280.0, 800.0];
const PANEL: f32 = 330.0;
const PLOT: f32 = 140.0;
const SWATCH: f32 = 12.0;
/// Smallest force that the longest arrow stands for, N; otherwise it is the largest force so far.
const MIN_FULL_FORCE: f64 = 0.2;

/// Reason why a session was not shown to its end.
#[derive(Debug, thiserror::Error)]
pub enum ViewError<E> {
    /// The window could not be opened.
    #[error(
        "no window could be opened ({0}); it needs a display, and a GPU or a software driver such as Mesa's lavapipe"
    )]
    Window(String),
    /// The picture of the window could not be taken or written.
    #[error("{}: {reason}; give a file that ends in .png and can be written", file.display())]
    Screenshot {
        /// The file.
        file: PathBuf,
        /// Reason of the failure.
        reason: String,
    },
    /// The sink of the records ended the session.
    #[error("{0}")]
    Sink(E),
}

/// Options of the display.
#[derive(Clone, Debug, Default)]
pub struct ViewOptions {
    /// Title of the window.
    pub title: String,
    /// Length of the session, s; if absent, it lasts until the window is closed.
    pub seconds: Option<f64>,
    /// File for a picture of the window at the end of the session.
    pub screenshot: Option<PathBuf>,
}

/// Runs a session in real time behind a window, until it has lasted, the window is closed or `stop` is set.
/// The mouse moves the steered hand, if there is one, in the plane that faces the viewer. Records go to
/// `sink`, as with [`HapticRenderer::run_realtime`]. To be called in the main thread, once.
///
/// # Errors
/// If the window cannot be opened, the picture cannot be written, or with what `sink` returns.
///
/// # Panics
/// The same as [`HapticRenderer::run_realtime`].
pub fn show<E: Send>(
    mut renderer: HapticRenderer,
    steering: Option<Steering>,
    options: &ViewOptions,
    stop: &AtomicBool,
    mut sink: impl FnMut(&Record) -> Result<(), E> + Send,
) -> Result<Session, ViewError<E>> {
    let settings = *renderer.settings();
    let placement = HandlePlacement::new(&settings, renderer.probe(), renderer.device().specification());
    let shared = Shared {
        live: Mutex::new(Live::new(renderer.device().specification(), 1.0 / settings.timing.rate)),
        screenshot: Arc::default(),
        running: AtomicBool::new(true),
    };
    let shared = &shared;
    let stage = Stage {
        watch: renderer.contact_monitor(),
        probe: renderer.probe().clone(),
        scene: renderer.scene().clone(),
        hand: steering.map(|steering| SteeredHand::new(steering, placement)),
    };
    let seconds = options.seconds.unwrap_or(f64::MAX);
    let (rendered, shown) = std::thread::scope(|scope| {
        let rendering = scope.spawn(move || {
            let _ended = ClearOnDrop(&shared.running);
            renderer.run_realtime(seconds, stop, |record| {
                lock(&shared.live).take(record);
                sink(record)
            })
        });
        let shown = open(stage, shared, options);
        stop.store(true, Ordering::Release);
        (rendering.join(), shown)
    });
    let session =
        rendered.unwrap_or_else(|panic| std::panic::resume_unwind(panic)).map_err(ViewError::Sink)?;
    shown.map_err(|error| ViewError::Window(error.to_string()))?;
    if let Some(file) = &options.screenshot {
        let image = lock(&shared.screenshot).take();
        write(file, image).map_err(|reason| ViewError::Screenshot { file: file.clone(), reason })?;
    }
    Ok(session)
}

/// State shared by the session's thread and the window's.
struct Shared {
    live: Mutex<Live>,
    screenshot: Arc<Mutex<Option<Arc<ColorImage>>>>,
    /// Whether the session is running.
    running: AtomicBool,
}

/// Neither thread leaves the value inconsistent when it panics, so poisoning is ignored.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Clears a flag when dropped.
struct ClearOnDrop<'a>(&'a AtomicBool);

impl Drop for ClearOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Release);
    }
}

/// Displayed objects, and the source of their contacts.
struct Stage {
    watch: ContactMonitor,
    probe: Object,
    scene: Scene,
    hand: Option<SteeredHand>,
}

/// Hand that the mouse moves.
struct SteeredHand {
    steering: Steering,
    placement: HandlePlacement,
    /// Intended pose in the world.
    aim: Pose,
}

impl SteeredHand {
    fn new(steering: Steering, placement: HandlePlacement) -> Self {
        Self { aim: placement.mesh_pose(&steering.aimed()), steering, placement }
    }

    /// Shifts the hand (m), and turns it about itself (a rotation vector); world axes.
    fn move_by(&mut self, shift: DVec3, turn: DVec3) {
        self.aim.translation += shift;
        self.aim.rotation = (DQuat::from_scaled_axis(turn) * self.aim.rotation).normalize();
        self.steering.aim(self.placement.device_pose(&self.aim));
    }
}

fn open(stage: Stage, shared: &Shared, options: &ViewOptions) -> eframe::Result {
    let native = NativeOptions {
        viewport: ViewportBuilder::default().with_inner_size(SIZE).with_title(&options.title),
        ..Default::default()
    };
    let wanted = options.screenshot.as_ref().map_or(Screenshot::None, |_| Screenshot::Wanted);
    eframe::run_native(
        &options.title,
        native,
        Box::new(move |context| Ok(Box::new(Window::new(context, stage, shared, wanted)?))),
    )
}

/// State of the window.
struct Window<'a> {
    stage: Stage,
    shared: &'a Shared,
    camera: Camera,
    gpu: RenderState,
    painter: Painter,
    scene: Vec<(MeshOnGpu, Pose)>,
    probe: MeshOnGpu,
    texture: egui::TextureId,
    screenshot: Screenshot,
}

/// State of the picture of the window that is taken at the end of the session.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Screenshot {
    None,
    Wanted,
    Due,
}

impl<'a> Window<'a> {
    fn new(
        context: &CreationContext<'_>,
        stage: Stage,
        shared: &'a Shared,
        screenshot: Screenshot,
    ) -> Result<Self, String> {
        let gpu = context.wgpu_render_state.clone().ok_or("there is no GPU to draw with")?;
        context.egui_ctx.set_visuals(egui::Visuals::light());
        let mut painter = Painter::new(&gpu.device, &gpu.queue);
        let on_gpu = |object: &Object| painter.mesh(&mesh_corners(&object.clod));
        let scene =
            stage.scene.objects().iter().map(|placed| (on_gpu(&placed.object), placed.pose)).collect();
        let probe = on_gpu(&stage.probe);
        let camera = first_view(&stage);
        let nothing = (probe.clone(), Pose::IDENTITY);
        let view = painter.paint([1, 1], &camera, &[], &nothing, &Picture::default());
        let texture =
            gpu.renderer.write().register_native_texture(&gpu.device, view, wgpu::FilterMode::Linear);
        Ok(Self { stage, shared, camera, gpu, painter, scene, probe, texture, screenshot })
    }

    /// Shows the picture, and handles the mouse there.
    fn show_scene(&mut self, ui: &mut Ui, pose: Pose, picture: &Picture) {
        let size = ui.available_size().max(egui::Vec2::splat(1.0));
        let scale = ui.ctx().pixels_per_point();
        let pixels = [size.x, size.y].map(|side| (side * scale).round().max(1.0) as u32);
        let probe = (self.probe.clone(), pose);
        let view = self.painter.paint(pixels, &self.camera, &self.scene, &probe, picture);
        self.gpu.renderer.write().update_egui_texture_from_wgpu_texture(
            &self.gpu.device,
            view,
            wgpu::FilterMode::Linear,
            self.texture,
        );
        let image = egui::Image::new((self.texture, size)).sense(Sense::click_and_drag());
        let response = ui.add(image);
        self.use_mouse(ui, &response, f64::from(size.y));
    }

    /// Returns the pose of the probe before the first step.
    fn initial_probe_pose(&self) -> Pose {
        self.stage.hand.as_ref().map_or(Pose::IDENTITY, |hand| hand.aim)
    }

    /// Handles the mouse: the first button moves the hand, and turns it with the shift key; the second
    /// orbits, the third pans, and the wheel zooms. Without a hand the first button orbits as well.
    fn use_mouse(&mut self, ui: &Ui, response: &Response, height: f64) {
        let drag = response.drag_delta();
        let (right, down) = (f64::from(drag.x) / height, f64::from(drag.y) / height);
        let (shift, wheel) = ui.input(|input| (input.modifiers.shift, input.smooth_scroll_delta.y));
        let by = |button| response.dragged_by(button);
        match &mut self.stage.hand {
            Some(hand) if by(PointerButton::Primary) => {
                let axes = self.camera.axes();
                let turn = (axes.y_axis * right + axes.x_axis * down) * TURN;
                let offset = self.camera.across(right, down);
                if shift { hand.move_by(DVec3::ZERO, turn) } else { hand.move_by(offset, DVec3::ZERO) }
            }
            _ if by(PointerButton::Middle) => self.camera.target -= self.camera.across(right, down),
            _ if response.dragged() => self.camera.orbit(right, down),
            _ => {}
        }
        if response.hovered() && wheel != 0.0 {
            self.camera.zoom((f64::from(wheel) * WHEEL).exp());
        }
    }

    /// Shows figures, levels and plots.
    fn show_panel(&self, ui: &mut Ui, live: &Live, levels: &[LevelColor]) {
        ui.add_space(4.0);
        ui.label(RichText::new(&live.device).strong());
        egui::Grid::new("figures").num_columns(2).show(ui, |ui| {
            for (name, value) in figures(live) {
                ui.label(name);
                ui.monospace(value);
                ui.end_row();
            }
        });
        ui.separator();
        ui.label(RichText::new("Levels of detail in touch").strong());
        egui::Grid::new("levels").num_columns(2).show(ui, |ui| {
            for level in levels {
                let [red, green, blue, _] = level.color;
                let (swatch, _) = ui.allocate_exact_size(egui::Vec2::splat(SWATCH), Sense::hover());
                ui.painter().rect_filled(swatch, 2.0, Color32::from_rgb(red, green, blue));
                ui.label(self.in_words(level));
                ui.end_row();
            }
        });
        ui.separator();
        let force = live.history.iter().map(|extremes| extremes.force).collect();
        plot(ui, "force, N", force, Color32::from_rgb(20, 110, 160));
        let depth = live.history.iter().map(|extremes| 1e3 * extremes.depth).collect();
        plot(ui, "depth, mm", depth, Color32::from_rgb(160, 40, 110));
        ui.separator();
        let hand = if self.stage.hand.is_some() { "drag: move the hand; with shift: turn it\n" } else { "" };
        ui.weak(format!("{hand}right drag: look around   middle drag: shift   wheel: nearer"));
    }

    fn in_words(&self, level: &LevelColor) -> String {
        let of = match level.object {
            None => Some(("probe", &self.stage.probe)),
            Some(object) => self.stage.scene.objects().get(object).map(|placed| ("scene", &placed.object)),
        };
        let Some((role, object)) = of else { return String::new() };
        let triangles = object.clod.levels.get(level.level as usize).map_or(0, |level| level.triangles);
        format!("{role}, level {}: {triangles} triangles, {} in touch", level.level, level.patches)
    }
}

impl eframe::App for Window<'_> {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        let live = lock(&self.shared.live).clone();
        let pose = live.latest.map_or_else(|| self.initial_probe_pose(), |record| record.object);
        let Stage { watch, probe, scene, .. } = &mut self.stage;
        let picture =
            Picture::new(watch.latest(), &probe.clod, &pose, scene, live.most.force.max(MIN_FULL_FORCE));
        egui::Panel::right("panel")
            .exact_size(PANEL)
            .show(ui, |ui| self.show_panel(ui, &live, &picture.levels));
        let bare = egui::Frame::NONE;
        egui::CentralPanel::default().frame(bare).show(ui, |ui| self.show_scene(ui, pose, &picture));

        let context = ui.ctx();
        if self.shared.running.load(Ordering::Acquire) {
            context.request_repaint_after(FRAME);
            return;
        }
        match std::mem::replace(&mut self.screenshot, Screenshot::None) {
            Screenshot::None => context.send_viewport_cmd(ViewportCommand::Close),
            Screenshot::Wanted => {
                let screenshot = Arc::clone(&self.shared.screenshot);
                context.request_screenshot(move |image| *lock(&screenshot) = Some(image));
                self.screenshot = Screenshot::Due;
            }
            Screenshot::Due if lock(&self.shared.screenshot).is_none() => self.screenshot = Screenshot::Due,
            Screenshot::Due => {}
        }
        context.request_repaint();
    }
}

/// Returns a view of the whole scene, with the probe beside it.
fn first_view(stage: &Stage) -> Camera {
    let spheres = stage.scene.objects().iter().map(|placed| {
        let source = &placed.object.clod.source;
        (placed.pose.transform_point(source.center), source.bounding_radius)
    });
    let radius = stage.probe.bounding_radius();
    let probe = (stage.hand.as_ref().map_or(DVec3::ZERO, |hand| hand.aim.translation), radius);
    let (low, high) = spheres
        .chain([probe])
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (center, radius)| {
            (low.min(center - radius), high.max(center + radius))
        });
    Camera::around(0.5 * (low + high), 0.33 * (high - low).length())
}

fn figures(live: &Live) -> Vec<(&'static str, String)> {
    let Some(record) = live.latest else { return vec![("time", "starting".to_owned())] };
    vec![
        ("time", format!("{:.1} s", record.time)),
        ("haptic loop", format!("{:.0} Hz", live.rates.haptic)),
        ("missed periods", format!("{:.0} a second", live.rates.missed)),
        ("contact loop", format!("{:.0} Hz", live.rates.contact)),
        ("contacts", record.contacts.to_string()),
        ("depth", format!("{:.3} mm", 1e3 * record.depth)),
        ("force", format!("{:.2} N", record.coupling.force.length())),
        ("torque", format!("{:.1} mN·m", 1e3 * record.coupling.torque.length())),
    ]
}

/// Plots columns over the time since they were recorded.
fn plot(ui: &mut Ui, name: &str, columns: Vec<f64>, color: Color32) {
    let count = columns.len() as f64;
    let points = (0..).map(f64::from).zip(columns).map(|(index, value)| [(index - count) * COLUMN, value]);
    let points = PlotPoints::from_iter(points);
    ui.label(name);
    Plot::new(name)
        .height(PLOT)
        .include_y(0.0)
        .include_x(-10.0)
        .include_x(0.0)
        .allow_drag(false)
        .allow_zoom(false)
        .allow_scroll(false)
        .show(ui, |plot| plot.line(Line::new(name, points).color(color)));
}

/// Writes a picture of the window.
fn write(file: &Path, image: Option<Arc<ColorImage>>) -> Result<(), String> {
    let image = image.ok_or("the window was closed before its picture was taken")?;
    let [width, height] = image.size.map(|side| side as u32);
    let bytes = image.pixels.iter().flat_map(|pixel| pixel.to_array()).collect();
    let picture = image::RgbaImage::from_raw(width, height, bytes).ok_or("the picture is damaged")?;
    picture.save(file).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use palpate::Settings;
    use palpate::device::Emulation;

    use super::*;
    use palpate::settings::DeviceSettings;

    /// The mouse moves the hand in the world, independently of the mapping to the device.
    #[test]
    fn a_hand_is_moved_in_the_world() {
        let device_frame = Pose::new(DVec3::X, DQuat::from_rotation_z(0.7));
        let settings = Settings {
            device: DeviceSettings { workspace_scale: 4.0, frame: device_frame, ..DeviceSettings::default() },
            ..Settings::default()
        };
        let probe = Object::model("lower-jaw@3000").expect("a model");
        let specification = Emulation::default().specification;
        let placement = HandlePlacement::new(&settings, &probe, &specification);
        let start = Pose::new(DVec3::new(0.01, 0.02, 0.0), DQuat::from_rotation_x(0.3));
        let (steering, _path) = Steering::new(start);
        let mut hand = SteeredHand::new(steering, placement);
        let before = hand.aim;
        hand.move_by(DVec3::Y * 0.1, DVec3::ZERO);
        hand.move_by(DVec3::ZERO, DVec3::Z * 0.5);
        let aimed = placement.mesh_pose(&hand.steering.aimed());
        assert!(aimed.translation.distance(before.translation + DVec3::Y * 0.1) < 1e-12);
        assert!(before.rotation_vector_to(&aimed).distance(DVec3::Z * 0.5) < 1e-12);
    }

    #[test]
    fn a_picture_that_was_not_taken_is_an_error() {
        assert!(write(Path::new("x.png"), None).unwrap_err().contains("closed before"));
        let image = Arc::new(ColorImage::filled([2, 2], Color32::RED));
        assert!(write(Path::new("no/such/folder/x.png"), Some(image)).is_err());
    }
}
