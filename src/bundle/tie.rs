//! Numbers that contours have in common with other contours of the same disc.
//!
//! Columns U of a contour, orthonormal over its whitened edge points, tell numbers `p = U^T r` that do not stand for themselves: what is left of the
//! contour, `(1 - U U^T) r`, is independent of them. They are taken out of an image's equations, and brought together where all images are at hand:
//! with those of the other camera's image of the same moment ([`super::same_light`]), or with the ovality of the printed disc, which is an unknown of
//! its own ([`super::outline`]). Bitangent features follow the ovality of both discs ([`super::tangent`]): they come as whole rows, weighed, their cost counted.

use super::assemble::SeenImage;
use super::edges::Feet;
use super::image_map::{MapColumn, MappedNormal, Slot, add_row};
use super::layout::Places;
use super::model::{DiscObservation, Loss};
use crate::conic::CommonNoise;
use crate::solve::NormalEquations;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Information on the part of an ovality that is told least, over that on the other, below which a contour does not fix both.
const LEAST: f64 = 1e-6;

/// How what both cameras say of rims goes together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alike {
    /// Correlation of the numbers of both cameras, 0 to 1.
    pub correlation: f64,
    /// Their variance over that which either image has.
    pub variance: f64,
}

impl Alike {
    /// What is taken until the images are asked.
    pub(super) const UNKNOWN: Self = Self { correlation: 0.5, variance: 1.0 };

    /// Factors of a pair of numbers in the two common rows.
    fn rows(self) -> [[f64; 2]; 2] {
        let Self { correlation: g, variance: v } = self;
        let root = (v * (1.0 - g * g)).sqrt();
        [[1.0 / v.sqrt(), 0.0], [-g / root, 1.0 / root]]
    }
}

/// What numbers of a contour are tied to.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Link {
    /// The same numbers of the disc's contour in the other camera.
    Light { alike: Alike, second: bool },
    /// The ovality (a, b) of the printed disc, mm: how many sigmas each of two numbers moves per mm; and whether the loss is asked: not of numbers that an
    /// ovality is still to explain.
    Oval { root: [[f64; 2]; 2], loss: bool },
}

/// What a contour has in common with others of the same disc.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tie {
    /// U.
    columns: CommonNoise,
    link: Link,
}

impl Tie {
    /// To the other camera's contour, by orthonormal columns given by their rows.
    pub(super) fn of_light<const N: usize>(rows: &[[f64; N]], second: bool) -> Self {
        let columns = CommonNoise::of_orthonormal(rows);
        Self { columns, link: Link::Light { alike: Alike::UNKNOWN, second } }
    }

    /// To the disc's ovality, by the movement of its whitened edge points per mm; `None` where these do not fix both parts of it.
    pub(super) fn of_oval(rows: &[[f64; 2]]) -> Option<Self> {
        let information: Matrix2<f64> = rows.iter().map(|r| Vector2::from(*r) * Vector2::from(*r).transpose()).sum();
        let eigen = information.symmetric_eigen();
        if !(eigen.eigenvalues.min() > LEAST * eigen.eigenvalues.max()) {
            return None;
        }
        let power = |p: f64| {
            let v = &eigen.eigenvectors;
            v * Matrix2::from_diagonal(&eigen.eigenvalues.map(|x| x.powf(p))) * v.transpose()
        };
        let (root, inverse) = (power(0.5), power(-0.5));
        let columns: Vec<[f64; 2]> = rows.iter().map(|r| (inverse * Vector2::from(*r)).into()).collect();
        let root = [0, 1].map(|k| [root[(k, 0)], root[(k, 1)]]);
        Some(Self { columns: CommonNoise::of_orthonormal(&columns), link: Link::Oval { root, loss: false } })
    }

    /// Of some of so many points, spread evenly along the contour, that stand for all of them: that of an ovality; `None` where they do not fix it.
    pub(super) fn of_some(&self, at: &[usize], all: usize) -> Option<Self> {
        let Link::Oval { root, loss } = self.link else { return None };
        let columns = self.columns.of_some(at, all);
        let columns: Vec<&[f64]> = columns.columns().map(|(column, _)| column).collect();
        let row = |i: usize| [0, 1].map(|k| columns.iter().zip(root).map(|(column, root)| column[i] * root[k]).sum());
        let rows: Vec<[f64; 2]> = (0..at.len()).map(row).collect();
        let mut out = Self::of_oval(&rows)?;
        if loss {
            out.ask_loss();
        }
        Some(out)
    }

    /// How it goes together with the other camera's; `None` where it is not tied to that.
    pub(super) fn alike(&self) -> Option<Alike> {
        match self.link {
            Link::Light { alike, .. } => Some(alike),
            Link::Oval { .. } => None,
        }
    }

    pub(super) fn set_alike(&mut self, new: Alike) {
        if let Link::Light { alike, .. } = &mut self.link {
            *alike = new;
        }
    }

    /// From now on the loss is asked, too.
    pub(super) fn ask_loss(&mut self) {
        if let Link::Oval { loss, .. } = &mut self.link {
            *loss = true;
        }
    }

    /// Columns of U.
    #[inline(always)]
    pub(super) fn columns(&self) -> impl Iterator<Item = &[f64]> {
        self.columns.columns().map(|(column, _)| column)
    }

    /// Products of the columns with a matrix given by its rows, one per point, from which they are taken.
    pub(super) fn take<const N: usize>(&self, rows: &mut [[f64; N]]) -> Vec<[f64; N]> {
        let mut out = vec![];
        for column in self.columns() {
            let mut sums = [0.0; N];
            for (row, u) in rows.iter().zip(column) {
                (0..N).for_each(|n| sums[n] += u * row[n]);
            }
            for (row, u) in rows.iter_mut().zip(column) {
                (0..N).for_each(|n| row[n] -= u * sums[n]);
            }
            out.push(sums);
        }
        out
    }

    /// The part of a contour in the right-hand side of the geodesic acceleration of the disc's ovality (see [`super::contour::bend`]); `None` where a
    /// circle has no image. Zero where it is tied to none.
    fn oval_bend(&self, images: &[SeenImage; 3], seen: &DiscObservation, h: f64) -> Option<[f64; 2]> {
        let Link::Oval { root, .. } = self.link else { return Some([0.0; 2]) };
        let distances = |k: usize| Some(Feet::of(&images[k].circle(seen.disc), seen)?.distance_px);
        let (before, here, behind) = (distances(0)?, distances(1)?, distances(2)?);
        let scale = images[1].observations.sigma_scale;
        let second = |i: usize| [(behind[i] - 2.0 * here[i] + before[i]) / (seen.edge.sigma_px[i] * scale * h * h)];
        let mut rows: Vec<[f64; 1]> = (0..here.len()).map(second).collect();
        seen.whiten(&mut rows);
        let numbers = self.take(&mut rows);
        Some([0, 1].map(|m| numbers.iter().zip(&root).map(|([p], by_mm)| p * by_mm[m] / scale).sum()))
    }

    /// The contributions of a contour of an image, in the order of the columns.
    #[inline(always)]
    pub(super) fn tied<'a, R: 'a>(
        &'a self,
        image: &'a SeenImage<'_>,
        disc: usize,
        numbers: impl Iterator<Item = (f64, R)> + 'a,
    ) -> impl Iterator<Item = Tied<R>> + 'a {
        let (scale, oval_mm) = (image.observations.sigma_scale, image.oval_mm(disc));
        numbers.enumerate().map(move |(k, (residual, row))| match self.link {
            Link::Light { alike, second } => Tied { of: (disc, k), to: To::Camera { alike, second }, residual, row },
            Link::Oval { root, loss } => {
                let by_mm = root[k].map(|x| x / scale);
                let residual = residual - by_mm[0] * oval_mm[0] - by_mm[1] * oval_mm[1];
                Tied { of: (disc, k), to: To::Disc { by_mm, loss }, residual, row }
            }
        })
    }
}

/// The bend of the ovality of each disc that contours of an image are tied to, by disc.
pub(super) fn oval_bends(images: &[SeenImage; 3], h: f64) -> Option<Vec<(usize, [f64; 2])>> {
    let tied = images[1].observations.discs.iter().filter_map(|seen| Some((seen, seen.tie.as_ref()?)));
    tied.map(|(seen, tie)| Some((seen.disc, tie.oval_bend(images, seen, h)?))).collect()
}

/// What one number of a contour is tied to.
#[derive(Debug, Clone, Copy)]
enum To {
    /// The same number of the other camera.
    Camera { alike: Alike, second: bool },
    /// The ovality of the disc, which moves it by so many sigmas per mm, and whether the loss is asked.
    Disc { by_mm: [f64; 2], loss: bool },
    /// The ovality of two discs, of a row that has its weight and whose cost is counted.
    Pair { discs: [usize; 2], by_mm: [f64; 4] },
}

/// One number that a contour has in common with others, with what moves it: nothing, the camera space, or the unknowns of its image.
#[derive(Debug, Clone)]
pub(super) struct Tied<R> {
    /// Disc of the target and which of its numbers.
    of: (usize, usize),
    to: To,
    pub(super) residual: f64,
    pub(super) row: R,
}

impl<const L: usize> Tied<SVector<f64, L>> {
    /// A row of a pair of discs, weighed, whose cost is counted already; `by_mm` as it moves by (a, b) of the first disc and of the second.
    pub(super) fn of_pair(discs: [usize; 2], by_mm: [f64; 4], residual: f64, row: SVector<f64, L>) -> Self {
        Self { of: (discs[0], 0), to: To::Pair { discs, by_mm }, residual, row }
    }

    /// In other coordinates, of which `map` is the derivative of its own.
    pub(super) fn moved_by<const M: usize>(&self, map: &SMatrix<f64, L, M>) -> Tied<SVector<f64, M>> {
        self.with(map.tr_mul(&self.row))
    }

    /// In the unknowns of the image.
    pub(super) fn mapped(&self, map: &[MapColumn]) -> Tied<Vec<f64>> {
        self.with(map.iter().map(|z| z.dot(self.row.as_slice())).collect())
    }
}

impl<R> Tied<R> {
    fn with<S>(&self, row: S) -> Tied<S> {
        let Self { of, to, residual, .. } = *self;
        Tied { of, to, residual, row }
    }

    pub(super) fn set_alike(&mut self, new: Alike) {
        if let To::Camera { alike, .. } = &mut self.to {
            *alike = new;
        }
    }

    /// How it goes together with the other camera's.
    fn alike(&self) -> Alike {
        self.light().map_or(Alike::UNKNOWN, |(alike, _)| alike)
    }

    /// The same, and whether it is the second of both; `None` where it waits for no other.
    fn light(&self) -> Option<(Alike, bool)> {
        match self.to {
            To::Camera { alike, second } => Some((alike, second)),
            To::Disc { .. } | To::Pair { .. } => None,
        }
    }
}

/// Contributions of a view whose other camera has not come yet, and the unknowns of its image.
struct Waiting<R> {
    view: usize,
    slots: Vec<Slot>,
    tied: Vec<Tied<R>>,
}

/// A contribution with the unknowns of its image.
type Of<'a, R> = (&'a [Slot], &'a Tied<R>);

/// Brings together what contours have in common, image after image in their order.
pub(super) struct Pairs<R> {
    waiting: Vec<Waiting<R>>,
    /// Place of the first disc's ovality among the unknowns.
    ovals: Option<usize>,
}

impl<R> Pairs<R> {
    pub(super) fn of(places: Option<&Places>) -> Self {
        Self { waiting: vec![], ovals: places.and_then(|p| p.ovals) }
    }
}

impl<R: Clone> Pairs<R> {
    /// Gives `add` each pair of a first and a second contribution that an image of the view completes.
    fn meet(&mut self, view: usize, (slots, tied): (&[Slot], &[Tied<R>]), mut add: impl FnMut(Of<'_, R>, Of<'_, R>)) {
        // All contours of a target are tied alike.
        if tied.first().is_none_or(|t| t.light().is_none()) {
            return;
        }
        let Some(at) = self.waiting.iter().position(|w| w.view == view) else {
            self.waiting.push(Waiting { view, slots: slots.to_vec(), tied: tied.to_vec() });
            return;
        };
        let other = self.waiting.swap_remove(at);
        for own in tied {
            let second = |t: &Tied<R>| t.light().is_some_and(|(_, second)| second);
            for before in other.tied.iter().filter(|t| t.of == own.of && second(t) != second(own)) {
                let (own, before) = ((slots, own), (&other.slots[..], before));
                if second(own.1) { add(before, own) } else { add(own, before) }
            }
        }
    }
}

fn if_asked(asked: bool, loss: Loss) -> Loss {
    if asked { loss } else { Loss::None }
}

impl Pairs<()> {
    /// Cost of what an image of the view completes.
    pub(super) fn cost(&mut self, view: usize, tied: &[Tied<()>], loss: Loss) -> f64 {
        let of_disc = |t: &Tied<()>| match t.to {
            To::Disc { loss: asked, .. } => 0.5 * if_asked(asked, loss).apply(t.residual * t.residual).0,
            To::Camera { .. } | To::Pair { .. } => 0.0,
        };
        let mut sum = tied.iter().map(of_disc).sum::<f64>();
        self.meet(view, (&[], tied), |(_, first), (_, second)| {
            for [a, b] in first.alike().rows() {
                let r = a * first.residual + b * second.residual;
                sum += 0.5 * loss.apply(r * r).0;
            }
        });
        sum
    }
}

impl Pairs<Vec<f64>> {
    /// Adds what an image of the view completes to the equations.
    pub(super) fn add(&mut self, e: &mut NormalEquations, view: usize, image: &MappedNormal, loss: Loss) {
        if let Some(first) = self.ovals {
            image.tied.iter().for_each(|tied| add_with_ovals(e, view, (&image.slots, tied), first, loss));
        }
        self.meet(view, (&image.slots, &image.tied), |first, second| {
            for [a, b] in first.1.alike().rows() {
                let residual = a * first.1.residual + b * second.1.residual;
                let (rho, weight) = loss.apply(residual * residual);
                let root = weight.sqrt();
                // Distances fall as the image moves outwards.
                let of = |(slots, tied): Of<'_, Vec<f64>>, factor: f64| {
                    let moves = if factor == 0.0 { &[][..] } else { slots };
                    let each = moves.iter().zip(&tied.row).map(|(slot, x)| (*slot, -factor * root * x));
                    each.collect::<Vec<_>>()
                };
                let row = [of(first, a), of(second, b)].concat();
                add_row(e, view, &row, residual * root);
                e.cost += 0.5 * rho;
            }
        });
    }
}

/// Adds a number that ovals move, whose places among the unknowns begin at `first`, to the equations.
fn add_with_ovals(e: &mut NormalEquations, view: usize, (slots, tied): Of<'_, Vec<f64>>, first: usize, loss: Loss) {
    let place = |disc: usize, k: usize| Slot::Global(first + 2 * disc + k);
    let (ovals, rho, weight): (Vec<(Slot, f64)>, f64, f64) = match tied.to {
        To::Camera { .. } => return,
        To::Disc { by_mm, loss: asked } => {
            let (rho, weight) = if_asked(asked, loss).apply(tied.residual * tied.residual);
            ((0..2).map(|k| (place(tied.of.0, k), by_mm[k])).collect(), rho, weight)
        }
        To::Pair { discs, by_mm } => ((0..4).map(|k| (place(discs[k / 2], k % 2), by_mm[k])).collect(), 0.0, 1.0),
    };
    let root = weight.sqrt();
    let own = slots.iter().copied().zip(tied.row.iter().copied());
    let row: Vec<(Slot, f64)> = own.chain(ovals).map(|(slot, x)| (slot, -root * x)).collect();
    add_row(e, view, &row, tied.residual * root);
    e.cost += 0.5 * rho;
}
