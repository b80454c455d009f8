//! Haptic devices for palpate: the device trait, an emulated device with a hand, and replay.
