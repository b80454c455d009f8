//! Draws a scene into a texture. It needs a GPU device and no window.

use bytemuck::{Pod, Zeroable, bytes_of, cast_slice};
use palpate::Pose;
use palpate::glam::{Mat4, Quat};
use wgpu::util::{BufferInitDescriptor, DeviceExt};
use wgpu::{
    BindGroup, BindGroupLayout, BlendState, Buffer, BufferUsages, ColorTargetState, ColorWrites,
    CommandEncoderDescriptor, CompareFunction, DepthBiasState, DepthStencilState, Device, Extent3d, Queue,
    RenderPass, RenderPipeline, TextureFormat, TextureUsages, TextureView,
};

use crate::camera::Camera;
use crate::picture::{Corner, Picture};

/// Formats of the color and depth targets, and number of samples per pixel.
const COLOR: TextureFormat = TextureFormat::Rgba8Unorm;
const DEPTH: TextureFormat = TextureFormat::Depth32Float;
const SAMPLES: u32 = 4;
/// Largest side of a picture, pixels.
const MAX_SIDE: u32 = 8192;

const BACKGROUND: wgpu::Color = wgpu::Color { r: 0.97, g: 0.97, b: 0.96, a: 1.0 };
const SCENE: [f32; 4] = [0.72, 0.74, 0.78, 1.0];
const PROBE: [f32; 4] = [0.86, 0.80, 0.70, 0.55];
/// Opacity of patches and arrows behind other objects.
const HIDDEN_OPACITY: f32 = 0.25;
/// Depth bias that draws patches over their own surface.
const PATCH_BIAS: DepthBiasState = DepthBiasState { constant: -16, slope_scale: -2.0, clamp: 0.0 };

/// Mesh on the GPU.
#[derive(Clone, Debug)]
pub struct MeshOnGpu {
    corners: Buffer,
    count: u32,
}

/// Uniforms of a mesh in WGSL's layout, one every `STRIDE` bytes.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Draw {
    clip_from_object: [[f32; 4]; 4],
    world_from_object: [[f32; 4]; 4],
    eye: [f32; 4],
    tint: [f32; 4],
}

const STRIDE: u64 = 256;

/// Painter of scenes.
#[derive(Debug)]
pub struct Painter {
    device: Device,
    queue: Queue,
    layout: BindGroupLayout,
    /// Pipelines for opaque objects, depth alone, patches over their surface, patches behind objects, and
    /// the translucent probe.
    solid: RenderPipeline,
    depth_alone: RenderPipeline,
    over: RenderPipeline,
    through: RenderPipeline,
    veil: RenderPipeline,
    target: Option<Target>,
}

/// Textures of the size of the picture.
#[derive(Debug)]
struct Target {
    size: [u32; 2],
    picture: wgpu::Texture,
    view: TextureView,
    samples: TextureView,
    depth: TextureView,
}

impl Painter {
    /// Creates a painter on a device.
    pub fn new(device: &Device, queue: &Queue) -> Self {
        let shader = device.create_shader_module(wgpu::include_wgsl!("view.wgsl"));
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("draw"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: true,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("view"),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = |label, compare, writes_depth, writes_color, bias| {
            let target = ColorTargetState {
                format: COLOR,
                blend: Some(BlendState::ALPHA_BLENDING),
                write_mask: if writes_color { ColorWrites::ALL } else { ColorWrites::empty() },
            };
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(label),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &shader,
                    entry_point: Some("place"),
                    compilation_options: Default::default(),
                    buffers: &[Some(wgpu::VertexBufferLayout {
                        array_stride: size_of::<Corner>() as u64,
                        step_mode: wgpu::VertexStepMode::Vertex,
                        attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm8x4],
                    })],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(writes_depth),
                    depth_compare: Some(compare),
                    stencil: Default::default(),
                    bias,
                }),
                multisample: wgpu::MultisampleState { count: SAMPLES, ..Default::default() },
                fragment: Some(wgpu::FragmentState {
                    module: &shader,
                    entry_point: Some("shade"),
                    compilation_options: Default::default(),
                    targets: &[Some(target)],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let (closer, always) = (CompareFunction::LessEqual, CompareFunction::Always);
        let none = DepthBiasState::default();
        Self {
            solid: pipeline("solid", closer, true, true, none),
            depth_alone: pipeline("depth alone", closer, true, false, none),
            over: pipeline("over", closer, false, true, PATCH_BIAS),
            through: pipeline("through", always, false, true, none),
            veil: pipeline("veil", closer, false, true, none),
            device: device.clone(),
            queue: queue.clone(),
            layout,
            target: None,
        }
    }

    /// Uploads triangles, three corners each, to the GPU.
    pub fn mesh(&self, corners: &[Corner]) -> MeshOnGpu {
        // A buffer must not be empty.
        let contents: &[u8] = if corners.is_empty() { &[0; 16] } else { cast_slice(corners) };
        let descriptor =
            BufferInitDescriptor { label: Some("corners"), contents, usage: BufferUsages::VERTEX };
        MeshOnGpu { corners: self.device.create_buffer_init(&descriptor), count: corners.len() as u32 }
    }

    /// Draws the scene's objects, the translucent probe, and a picture of the contacts. Returns the target
    /// texture, which is new if the size (pixels) has changed.
    pub fn paint(
        &mut self,
        size: [u32; 2],
        camera: &Camera,
        scene: &[(MeshOnGpu, Pose)],
        probe: &(MeshOnGpu, Pose),
        picture: &Picture,
    ) -> &TextureView {
        let size = size.map(|side| side.clamp(1, MAX_SIDE));
        let (patches, arrows) = (self.mesh(&picture.patches), self.mesh(&picture.arrows));
        let here = Pose::IDENTITY;
        let opaque = [1.0; 4];
        let hidden = [1.0, 1.0, 1.0, HIDDEN_OPACITY];
        let mut steps: Vec<(&RenderPipeline, &MeshOnGpu, &Pose, [f32; 4])> = Vec::new();
        steps.extend(scene.iter().map(|(mesh, pose)| (&self.solid, mesh, pose, SCENE)));
        steps.push((&self.over, &patches, &here, opaque));
        steps.push((&self.through, &patches, &here, hidden));
        steps.push((&self.solid, &arrows, &here, opaque));
        // Only the nearest surface of the probe is drawn.
        steps.push((&self.depth_alone, &probe.0, &probe.1, PROBE));
        steps.push((&self.veil, &probe.0, &probe.1, PROBE));
        steps.push((&self.over, &patches, &here, [1.0, 1.0, 1.0, 0.6]));
        steps.push((&self.through, &arrows, &here, [1.0, 1.0, 1.0, 0.8]));

        let clip_from_world = camera.clip_from_world(f64::from(size[0]) / f64::from(size[1]));
        let eye = camera.eye().as_vec3().extend(1.0).to_array();
        let mut draws = vec![0; steps.len() * STRIDE as usize];
        for ((.., pose, tint), bytes) in steps.iter().zip(draws.chunks_exact_mut(STRIDE as usize)) {
            let world = matrix(pose);
            let draw = Draw {
                clip_from_object: (clip_from_world * world).to_cols_array_2d(),
                world_from_object: world.to_cols_array_2d(),
                eye,
                tint: *tint,
            };
            bytes[..size_of::<Draw>()].copy_from_slice(bytes_of(&draw));
        }
        let bindings = self.bindings(&draws);

        let target = match self.target.take() {
            Some(target) if target.size == size => target,
            _ => Target::new(&self.device, size),
        };
        let mut encoder = self.device.create_command_encoder(&CommandEncoderDescriptor::default());
        {
            let mut pass = target.begin(&mut encoder);
            for (number, (pipeline, mesh, ..)) in (0..).zip(&steps) {
                draw(&mut pass, pipeline, mesh, &bindings, number);
            }
        }
        self.queue.submit([encoder.finish()]);
        &self.target.insert(target).view
    }

    /// Returns the texture that was drawn on last.
    pub fn texture(&self) -> Option<&wgpu::Texture> {
        self.target.as_ref().map(|target| &target.picture)
    }

    fn bindings(&self, draws: &[u8]) -> BindGroup {
        let uniform =
            BufferInitDescriptor { label: Some("draws"), contents: draws, usage: BufferUsages::UNIFORM };
        let buffer = self.device.create_buffer_init(&uniform);
        let one = wgpu::BufferBinding {
            buffer: &buffer,
            offset: 0,
            size: std::num::NonZero::new(size_of::<Draw>() as u64),
        };
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("draws"),
            layout: &self.layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(one) }],
        })
    }
}

fn draw(
    pass: &mut RenderPass<'_>,
    pipeline: &RenderPipeline,
    mesh: &MeshOnGpu,
    bindings: &BindGroup,
    number: u32,
) {
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, bindings, &[number * STRIDE as u32]);
    pass.set_vertex_buffer(0, mesh.corners.slice(..));
    pass.draw(0..mesh.count, 0..1);
}

fn matrix(pose: &Pose) -> Mat4 {
    let q = pose.rotation;
    let rotation = Quat::from_xyzw(q.x as f32, q.y as f32, q.z as f32, q.w as f32);
    Mat4::from_rotation_translation(rotation, pose.translation.as_vec3())
}

impl Target {
    fn new(device: &Device, size: [u32; 2]) -> Self {
        let texture = |label, format, samples, usage| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let drawn_on = TextureUsages::RENDER_ATTACHMENT;
        let read = TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_SRC;
        let picture = texture("picture", COLOR, 1, drawn_on | read);
        let view = |texture: &wgpu::Texture| texture.create_view(&Default::default());
        Self {
            size,
            view: view(&picture),
            samples: view(&texture("samples", COLOR, SAMPLES, drawn_on)),
            depth: view(&texture("depth", DEPTH, SAMPLES, drawn_on)),
            picture,
        }
    }

    fn begin<'a>(&self, encoder: &'a mut wgpu::CommandEncoder) -> RenderPass<'a> {
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("view"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.samples,
                depth_slice: None,
                resolve_target: Some(&self.view),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(BACKGROUND),
                    store: wgpu::StoreOp::Discard,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(1.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }
}
