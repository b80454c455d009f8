//! Haptic textures: directional penetration depth on CPU and GPU.
