//! Ellipses by the row of their centre, so that what lies near one is found without asking all.

use crate::conic::Ellipse;
use crate::frames::Pixel;

/// Places of ellipses in a list, in the order of the rows of their centres.
#[derive(Debug, Default)]
pub(crate) struct ByRow {
    /// Each centre and its place in the list: the ellipses themselves lie far apart, and most are asked for no more than this.
    order: Vec<(Pixel, usize)>,
    /// Largest major semi-axis, px.
    pub(crate) largest_px: f64,
}

impl ByRow {
    /// Of all ellipses of a list.
    pub(crate) fn new<'a>(ellipses: impl Iterator<Item = &'a Ellipse>) -> Self {
        let mut out = Self::default();
        for (k, e) in ellipses.enumerate() {
            out.order.push((e.center_px, k));
            out.largest_px = out.largest_px.max(e.semi_major_px);
        }
        out.order.sort_unstable_by(|a, b| a.0.v_px.total_cmp(&b.0.v_px).then(a.1.cmp(&b.1)));
        out
    }

    /// Places of all ellipses whose centres may lie within `reach_px` of a point, in the order of rows.
    pub(crate) fn near(&self, point: Pixel, reach_px: f64) -> impl Iterator<Item = usize> {
        let from = self.order.partition_point(|x| x.0.v_px < point.v_px - reach_px);
        let rows = self.order[from..].iter().take_while(move |x| x.0.v_px <= point.v_px + reach_px);
        rows.filter(move |x| (x.0.u_px - point.u_px).abs() <= reach_px).map(|x| x.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_near_is_missed() {
        let list: Vec<Ellipse> = (0..200)
            .map(|k| {
                let (u, v) = (f64::from((k * 37) % 101), f64::from((k * 53) % 97));
                Ellipse { center_px: Pixel::new(u, v), semi_major_px: 2.0, semi_minor_px: 1.0, angle_rad: 0.0 }
            })
            .collect();
        let by_row = ByRow::new(list.iter());
        for e in &list {
            let away = |x: &Ellipse| (x.center_px.u_px - e.center_px.u_px).hypot(x.center_px.v_px - e.center_px.v_px);
            let mut found: Vec<usize> = by_row.near(e.center_px, 9.0).filter(|k| away(&list[*k]) <= 9.0).collect();
            found.sort_unstable();
            let plain: Vec<usize> = (0..list.len()).filter(|k| away(&list[*k]) <= 9.0).collect();
            assert!(plain.len() > 1);
            assert_eq!(found, plain);
            assert!(by_row.near(e.center_px, 9.0).count() < 15);
        }
    }
}
