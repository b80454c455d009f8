//! WGSL compute kernels of the palpate haptic rendering engine.
