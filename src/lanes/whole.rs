//! Small whole numbers, whose sums are alike however many are added at a time.

/// Bytes that go into one set of sums at most, so that 32 bits hold them.
pub(crate) const BYTES: usize = 1024;

/// One by one what [`super::Lanes::sums_of_bytes`] is.
#[inline(always)]
pub(super) fn sums_of_bytes(bytes: &[u8], n: usize, ground: u8, alone: bool) -> [i32; 4] {
    let mut sums = [0; 4];
    for (i, (x, y)) in bytes[1..].iter().zip(bytes).take(n).enumerate() {
        let (x, step) = (i32::from(*x) - i32::from(ground), i32::from(*x) - i32::from(*y));
        sums[0] += x;
        sums[1] += i as i32 * x;
        sums[2] += x * x;
        sums[3] += if alone && i == 0 { 0 } else { step * step };
    }
    sums
}

/// One by one: bit `i` is set where number `i` is not zero.
#[inline(always)]
pub(super) fn bits_of(x: &[u16; 32]) -> u32 {
    let mut bits = 0;
    for i in 0..32 {
        bits |= u32::from(x[i] != 0) << i;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Kernel, Lanes, run_all};

    #[derive(Clone)]
    struct Sums<'a>(&'a [u8], usize, u8, bool);
    impl Kernel for Sums<'_> {
        type Output = [i32; 4];
        #[inline(always)]
        fn run<L: Lanes>(self) -> [i32; 4] {
            let Self(bytes, n, ground, alone) = self;
            L::sums_of_bytes(&bytes[..=n.next_multiple_of(8)], n, ground, alone)
        }
    }

    /// Lists of all lengths, and the largest sums that there are.
    #[test]
    fn sums_of_bytes_are_those_of_single_ones() {
        let mixed: Vec<u8> = (0..=1024_u32).map(|i| (i * i * 37 % 251) as u8).collect();
        let steep: Vec<u8> = (0..=1024).map(|i| if i % 2 == 0 { 255 } else { 0 }).collect();
        let (high, low) = (vec![255; 1025], vec![0; 1025]);
        for (bytes, ground) in [(&mixed, 120), (&steep, 0), (&steep, 255), (&high, 0), (&low, 255)] {
            for n in [1, 2, 7, 8, 9, 16, 23, 100, BYTES - 1, BYTES] {
                let wanted = (1..=n).fold([0_i64; 4], |sum, i| {
                    let (x, y) =
                        (i64::from(bytes[i]) - i64::from(ground), i64::from(bytes[i]) - i64::from(bytes[i - 1]));
                    [sum[0] + x, sum[1] + (i as i64 - 1) * x, sum[2] + x * x, sum[3] + y * y]
                });
                let first = (i64::from(bytes[1]) - i64::from(bytes[0])).pow(2);
                for (alone, less) in [(false, 0), (true, first)] {
                    for found in run_all(&Sums(bytes, n, ground, alone)) {
                        let [x, ix, xx, steps] = wanted;
                        assert_eq!(found.map(i64::from), [x, ix, xx, steps - less], "{n} bytes");
                    }
                }
            }
        }
    }

    #[derive(Clone)]
    struct Bits([u16; 32]);
    impl Kernel for Bits {
        type Output = u32;
        #[inline(always)]
        fn run<L: Lanes>(self) -> u32 {
            L::bits_of(&self.0)
        }
    }

    #[test]
    fn every_number_has_its_bit() {
        for wanted in [0, u32::MAX, 1, 1 << 31, 0x00ff_ff00, 0x1248_7531, 0x8000_8001] {
            for value in [1, 0x100, 0x7fff, 0x8000, 0xffff] {
                let x = std::array::from_fn(|i| if wanted >> i & 1 == 1 { value } else { 0 });
                assert!(run_all(&Bits(x)).into_iter().all(|found| found == wanted), "{wanted:x} of {value:x}");
            }
        }
    }
}
