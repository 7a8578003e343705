//! Where the rows of an image cut an ellipse.

use super::Frame;

/// Columns, relative to the centre, where the row `dv` below it cuts an ellipse: `shear dv -+ (reach^2 - fall^2 dv^2)^(1/2)`, px.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cut {
    pub(crate) shear: f64,
    pub(crate) reach2: f64,
    pub(crate) fall2: f64,
}

impl Cut {
    /// Of the ellipse about the centre and along the axes of a frame with the semi-axes `a` and `b`, px; without both no row cuts it.
    #[inline]
    pub(crate) fn new(frame: &Frame, a: f64, b: f64) -> Self {
        if !(a > 0.0 && b > 0.0) {
            return Self { shear: 0.0, reach2: -1.0, fall2: 0.0 };
        }
        let (ia, ib) = (1.0 / (a * a), 1.0 / (b * b));
        let m00 = frame.cos * frame.cos * ia + frame.sin * frame.sin * ib;
        let m01 = frame.cos * frame.sin * (ia - ib);
        Self { shear: -m01 / m00, reach2: 1.0 / m00, fall2: ia * ib / (m00 * m00) }
    }

    /// The first and the last of them.
    #[inline]
    pub(crate) fn span(&self, dv: f64) -> Option<(f64, f64)> {
        let square = self.reach2 - self.fall2 * dv * dv;
        (square >= 0.0).then(|| {
            let (middle, half) = (self.shear * dv, square.sqrt());
            (middle - half, middle + half)
        })
    }
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::conic::Ellipse;
    use crate::frames::Pixel;

    /// Against the implicit form, for turned and slim ellipses; rows beside it do not cut it.
    #[test]
    fn rows_cut_the_ellipse_where_they_meet_it() {
        for (a, b, angle_rad) in [(9.0, 4.0, 0.7), (30.0, 2.0, -1.2), (5.0, 5.0, 0.0), (12.0, 3.0, 1.57)] {
            let e = Ellipse { center_px: Pixel::new(3.0, -2.0), semi_major_px: a, semi_minor_px: b, angle_rad };
            let cut = Cut::new(&Frame::new(&e), a, b);
            let half = (a * angle_rad.sin()).hypot(b * angle_rad.cos());
            for part in [-0.99, -0.3, 0.0, 0.5, 0.9] {
                let (first, last) = cut.span(part * half).expect("a row through the ellipse");
                assert!(first < last);
                for du in [first, last] {
                    let off = e.implicit(Pixel::new(3.0 + du, -2.0 + part * half));
                    assert!(off.abs() < 1e-9, "{a} x {b}: {off}");
                }
            }
            assert!(cut.span(1.001 * half).is_none() && cut.span(-1.001 * half).is_none());
            assert!(Cut::new(&Frame::new(&e), a, -0.1).span(0.0).is_none());
        }
    }
}
