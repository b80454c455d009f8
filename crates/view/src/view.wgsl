// Triangles lit from where they are seen.

struct Draw {
    clip_from_object: mat4x4f,
    world_from_object: mat4x4f,
    eye: vec4f,
    tint: vec4f,
}

@group(0) @binding(0) var<uniform> draw: Draw;

struct Placed {
    @builtin(position) clip: vec4f,
    @location(0) place: vec3f,
    @location(1) color: vec4f,
}

@vertex
fn place(@location(0) position: vec3f, @location(1) color: vec4f) -> Placed {
    var placed: Placed;
    placed.clip = draw.clip_from_object * vec4f(position, 1.0);
    placed.place = (draw.world_from_object * vec4f(position, 1.0)).xyz;
    placed.color = color * draw.tint;
    return placed;
}

@fragment
fn shade(placed: Placed) -> @location(0) vec4f {
    let normal = normalize(cross(dpdx(placed.place), dpdy(placed.place)));
    let facing = abs(dot(normal, normalize(draw.eye.xyz - placed.place)));
    return vec4f(placed.color.rgb * (0.3 + 0.7 * facing), placed.color.a);
}
