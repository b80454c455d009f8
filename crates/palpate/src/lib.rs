//! 6-DoF haptic rendering: feel one complex mesh touching another, force and torque at 1 kHz.
