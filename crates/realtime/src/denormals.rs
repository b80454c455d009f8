//! Flushing of denormal numbers to zero.

use crate::Outcome;

/// Makes the calling thread, and those that it starts, treat denormal numbers as zero.
pub fn flush() -> Outcome {
    if set() {
        Outcome::granted("flushed to zero")
    } else {
        Outcome::not_asked("kept: not supported on this processor")
    }
}

/// Sets the bits of MXCSR that flush results to zero (FTZ, bit 15) and treat operands as zero (DAZ, bit 6).
#[cfg(target_arch = "x86_64")]
fn set() -> bool {
    use std::arch::asm;

    const FLUSH: u32 = 1 << 15 | 1 << 6;
    let mut control = 0_u32;
    // SAFETY: stores the register in a variable of its size, and loads it with two more bits, which every
    // x86-64 processor has. Rounding and masked exceptions are unchanged. Rust and LLVM evaluate constants as
    // if denormal numbers were kept, and guarantee nothing for a thread that flushes them: a denormal number
    // may keep its value or be zero. No code of this thread depends on which: forces, lengths and times are
    // never that small.
    unsafe {
        asm!("stmxcsr [{}]", in(reg) &raw mut control, options(nostack, preserves_flags));
        control |= FLUSH;
        asm!("ldmxcsr [{}]", in(reg) &raw const control, options(nostack, preserves_flags, readonly));
    }
    true
}

/// Sets the bit of FPCR that flushes results and operands to zero (FZ, bit 24).
#[cfg(target_arch = "aarch64")]
fn set() -> bool {
    use std::arch::asm;

    const FLUSH: u64 = 1 << 24;
    // SAFETY: reads the register and writes it with one more bit, which every AArch64 processor has. The rest
    // is as for x86-64.
    unsafe {
        let mut control: u64;
        asm!("mrs {}, fpcr", out(reg) control, options(nomem, nostack, preserves_flags));
        control |= FLUSH;
        asm!("msr fpcr, {}", in(reg) control, options(nostack, preserves_flags));
    }
    true
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn set() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use std::hint::black_box;

    use super::*;

    /// Returns half of the smallest normal number, computed at run time.
    fn half_of_smallest() -> f64 {
        black_box(black_box(f64::MIN_POSITIVE) * black_box(0.5))
    }

    #[test]
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    fn denormal_numbers_are_zero_in_the_thread_that_asked() {
        let flushed = std::thread::spawn(|| {
            let before = half_of_smallest();
            assert!(flush().is_granted());
            let denormal = black_box(f64::from_bits(1));
            (before, half_of_smallest(), denormal * black_box(1e300), black_box(1.0) / black_box(3.0))
        });
        let (before, result, operand, ordinary) = flushed.join().expect("no panic");
        assert!(before > 0.0, "a thread keeps them by default");
        assert_eq!((result, operand), (0.0, 0.0));
        assert_eq!(ordinary, 1.0 / 3.0);
        assert!(half_of_smallest() > 0.0, "the other threads keep them");
    }
}
