//! Integration tests of the palpate haptic rendering engine.
