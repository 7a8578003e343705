//! From images to the normal equations: each image is summed in its own camera space and then mapped to the unknowns.
//!
//! Camera space of an image: intrinsics (10), turn w and shift v of everything in the camera frame (6), shape of the target
//! (3): 19 numbers, whatever the scene. With `s_c` the solver frame of camera c, E its turn into the lens frame and T the
//! motion from the first camera's solver frame:
//! ```text
//! intrinsics = A dchart        (w, v) = (B dchart, 0) + diag(E, E) dmotion + diag(E, E) Ad(T) dpose
//! dpose      = Ad(plane) dplane_or_planar     for views in the common plane
//! ```
//! Behind a window eight more follow, its turn and its layers in the camera frame; the turn is `B dchart + E dturn`, since the
//! window stands in the solver frame.

use super::by_disc::ByDisc;
use super::chart::SolverCamera;
use super::contour::{self, EDGE, EDGE_BEHIND, SeenCircle};
use super::edges::{self, Columns};
use super::image_map::{self, MapColumn, MappedNormal, add_mapped, image_map, mapped, mirror};
use super::layout::Places;
use super::model::{DiscObservation, ImageObservations, Model};
use super::points;
use super::state::State;
use super::tangent;
use super::tie::{self, Pairs, Tie, Tied};
use crate::camera::{INTRINSICS, WINDOW_STEPS};
use crate::frames::{Cam, Target};
use crate::rigid::Motion;
use crate::solve::{Gradient, NormalEquations};
use crate::threads::{self, OwnMemory, gathered};
use nalgebra::{DVector, Matrix4, SMatrix, SVector, Vector3, Vector4};
use rayon::prelude::*;

/// Size of an image's camera space without shape, and with it.
pub(super) const SPACE: usize = INTRINSICS + 6;
pub(super) const LOCAL: usize = SPACE + 3;
/// The same behind a window.
pub(super) const LOCAL_BEHIND: usize = LOCAL + WINDOW_STEPS;

/// Coupling of one estimated disc with its image.
pub(super) struct OffsetNormal<const L: usize> {
    pub(super) disc: usize,
    pub(super) own: Matrix4<f64>,
    pub(super) with_local: SMatrix<f64, 4, L>,
    pub(super) b: Vector4<f64>,
}

/// Normal equations of one image in its camera space.
pub(super) struct ImageNormal<const L: usize> {
    pub(super) h: SMatrix<f64, L, L>,
    pub(super) b: SVector<f64, L>,
    pub(super) offsets: Vec<OffsetNormal<L>>,
    /// What it has in common with others.
    pub(super) tied: Vec<Tied<SVector<f64, L>>>,
    pub(super) cost: f64,
}

impl<const L: usize> ImageNormal<L> {
    pub(super) fn zeros() -> Self {
        Self { h: SMatrix::zeros(), b: SVector::zeros(), offsets: vec![], tied: vec![], cost: 0.0 }
    }
}

/// Memory that is used again from image to image of one state.
#[derive(Default)]
struct Scratch {
    edges: edges::Scratch,
    points: points::Scratch,
    /// Of the states before, at and behind a bend.
    bent_points: [points::Scratch; 3],
    tangent: tangent::Scratch,
    map: Vec<MapColumn>,
    normal: MappedNormal,
}

/// One image with everything that its residuals need.
pub(super) struct SeenImage<'a> {
    pub(super) model: &'a Model,
    pub(super) observations: &'a ImageObservations,
    pub(super) camera: SolverCamera,
    pub(super) cam_from_target: Motion<Cam, Target>,
    pub(super) shape_mm: [f64; 3],
    pub(super) offsets_mm: &'a [[f64; 4]],
    ovals_mm: &'a [[f64; 2]],
    slopes: &'a [[f64; 2]],
    /// Whether it stands beside the other camera's image, so that ties to that hold.
    pub(super) paired: bool,
}

impl<'a> SeenImage<'a> {
    pub(super) fn of(model: &'a Model, state: &'a State, observations: &'a ImageObservations) -> Option<Self> {
        let camera = SolverCamera::seen(model, state, observations.camera)?;
        Some(Self::through(model, state, observations, camera))
    }

    /// With its camera at hand: that is found once for all images.
    fn through(model: &'a Model, state: &'a State, observations: &'a ImageObservations, camera: SolverCamera) -> Self {
        let (c, v) = (observations.camera, observations.view);
        let view = &state.views[v];
        let turn: Motion<Cam, Cam> = Motion::new(camera.cam_from_solver, Vector3::zeros());
        let cam_from_target = turn * state.camera_from_first[c] * view.first_from_target;
        let shape_mm = if model.target.per_view() { view.shape_mm } else { state.shape_mm };
        let (offsets_mm, ovals_mm, slopes) = (&state.offsets_mm[..], &state.ovals_mm[..], &state.slopes[..]);
        Self { model, observations, camera, cam_from_target, shape_mm, offsets_mm, ovals_mm, slopes, paired: true }
    }

    /// Centre and radius of disc `j`, offsets included, mm.
    pub(super) fn disc(&self, j: usize) -> (Vector3<f64>, f64) {
        let (mut center, mut radius) = self.model.target.nominal_disc(j, &self.shape_mm);
        if let Some(o) = self.offsets_mm.get(j) {
            center += Vector3::new(o[0], o[1], o[2]);
            radius += o[3];
        }
        (center, radius)
    }

    pub(super) fn circle(&self, j: usize) -> SeenCircle<'_> {
        let (center, radius) = self.disc(j);
        let flat = SeenCircle { camera: &self.camera.camera, cam_from_target: self.cam_from_target, center, radius };
        self.slopes.get(j).map_or(flat, |slope| flat.leaning(*slope))
    }

    /// The tie of one of its contours.
    #[inline(always)]
    pub(super) fn tie<'s>(&self, seen: &'s DiscObservation) -> Option<&'s Tie> {
        seen.tie.as_deref().filter(|tie| self.paired || tie.alike().is_none())
    }

    /// Ovality of a disc, mm.
    pub(super) fn oval_mm(&self, disc: usize) -> [f64; 2] {
        self.ovals_mm.get(disc).copied().unwrap_or_default()
    }

    /// Cost of the image by itself, and what it has in common with others.
    fn cost(&self, scratch: &mut Scratch) -> Option<(f64, Vec<Tied<()>>)> {
        let mut tied = vec![];
        let mut sum = match edges::allows(&self.camera.camera) {
            true => edges::cost(self, &mut scratch.edges, &mut tied)? + points::cost(self, &mut scratch.points)?,
            false => self.plain_cost(&mut tied)? + points::plain_cost(self)?,
        };
        for pair in &self.observations.pairs {
            sum += tangent::cost(self, pair, &mut scratch.tangent)?;
        }
        Some((sum, tied))
    }

    /// Cost of the contours, point by point; what they have in common with others is added to `tied`.
    pub(super) fn plain_cost(&self, tied: &mut Vec<Tied<()>>) -> Option<f64> {
        self.observations.discs.iter().map(|seen| contour::cost(self, seen, tied)).sum()
    }

    /// Adds the contours, point by point; with the discs' own equations where each is `estimated`.
    pub(super) fn plain_contours<const E: usize, const L: usize>(
        &self,
        estimated: bool,
        out: &mut ImageNormal<L>,
    ) -> Option<()> {
        for seen in &self.observations.discs {
            let n = contour::linearise::<E>(self, seen)?;
            let map = self.disc_map::<E, L>(seen.disc);
            let hm = n.h * map;
            out.h += map.tr_mul(&hm);
            out.b += map.tr_mul(&n.b);
            out.cost += n.cost;
            out.tied.extend(n.tied.iter().map(|t| t.moved_by(&map)));
            if estimated {
                let o = self.offset_map::<E>();
                out.offsets.push(OffsetNormal {
                    disc: seen.disc,
                    own: o.tr_mul(&(n.h * o)),
                    with_local: o.tr_mul(&hm),
                    b: o.tr_mul(&n.b),
                });
            }
        }
        Some(())
    }

    /// Edge unknowns (intrinsics, turn, shift, radius) of disc `j` by the image's camera space.
    pub(super) fn disc_map<const E: usize, const L: usize>(&self, j: usize) -> SMatrix<f64, E, L> {
        let mut m = SMatrix::<f64, E, L>::zeros();
        m.fixed_view_mut::<SPACE, SPACE>(0, 0).fill_with_identity();
        let d = self.model.target.disc_derivative(j);
        for k in 0..3 {
            let shift = self.cam_from_target.rotation * Vector3::new(d[0][k], d[1][k], d[2][k]);
            m.fixed_view_mut::<3, 1>(INTRINSICS + 3, SPACE + k).copy_from(&shift);
            m[(EDGE - 1, SPACE + k)] = d[3][k];
        }
        (EDGE..E).for_each(|k| m[(k, LOCAL + k - EDGE)] = 1.0);
        m
    }

    /// Edge unknowns by the offsets (dx, dy, dz, dr) of a disc.
    pub(super) fn offset_map<const E: usize>(&self) -> SMatrix<f64, E, 4> {
        let mut m = SMatrix::<f64, E, 4>::zeros();
        m.fixed_view_mut::<3, 3>(INTRINSICS + 3, 0).copy_from(&self.cam_from_target.rotation);
        m[(EDGE - 1, 3)] = 1.0;
        m
    }
}

/// The cameras of a state, as far as images need them.
fn cameras(model: &Model, state: &State) -> Option<Vec<SolverCamera>> {
    (0..model.cameras.len()).map(|c| SolverCamera::seen(model, state, c)).collect()
}

/// Columns of the camera space that the unknowns of camera `c` move (where it stands behind no window).
pub(super) fn columns(model: &Model, places: &Places, c: usize) -> Columns {
    let wanted = |k: usize| match k {
        k if k < INTRINSICS => model.cameras[c].free[k],
        k if k < SPACE => true,
        k => model.target.free[k - SPACE],
    };
    Columns::of(wanted, places.offsets.is_some())
}

/// Edge points (a pair of discs counts for as many as take its time) from which threads are worth waking: they
/// cost some ten microseconds.
const THREADED: usize = 4000;
const PAIR: usize = 60;

pub(super) fn threaded(images: &[&ImageObservations]) -> bool {
    let points = |i: &&ImageObservations| -> usize {
        i.pairs.len() * PAIR + i.discs.iter().map(|d| d.edge.u_px.len()).sum::<usize>() + i.points.disc.len()
    };
    threads::several() && images.iter().map(points).sum::<usize>() >= THREADED
}

/// Cost of all images; `None` where one of them has no meaning. Summed in the order of the images.
pub(super) fn cost(model: &Model, state: &State) -> Option<f64> {
    cost_in(model, state, |_| state)
}

/// The same with a state for each image, all with the cameras of one, which may stand elsewhere.
pub(super) fn cost_in<'a>(
    model: &'a Model,
    cameras_of: &State,
    state: impl Fn(&ImageObservations) -> &'a State + Sync,
) -> Option<f64> {
    let cameras = cameras(model, cameras_of)?;
    let images: Vec<&ImageObservations> = model.images.iter().collect();
    let memory = OwnMemory::<Scratch>::new();
    let of = |o: &&ImageObservations| {
        memory.with(|scratch| SeenImage::through(model, state(o), o, cameras[o.camera]).cost(scratch))
    };
    let each: Option<Vec<(f64, Vec<Tied<()>>)>> = gathered(threaded(&images), &images, of);
    let mut pairs = Pairs::of(None);
    each.map(|each| {
        let whole = images.iter().zip(&each).map(|(o, (own, tied))| own + pairs.cost(o.view, tied, model.loss));
        whole.sum()
    })
}

/// Normal equations of one image in the unknowns that it touches.
fn linearised(model: &Model, places: &Places, state: &State, image: &SeenImage, scratch: &mut Scratch) -> Option<()> {
    image_map(model, places, state, image, &mut scratch.map);
    let camera = &image.camera.camera;
    let estimated = places.offsets.is_some();
    if camera.window().is_some() {
        let mut normal = ImageNormal::<LOCAL_BEHIND>::zeros();
        image.plain_contours::<EDGE_BEHIND, LOCAL_BEHIND>(estimated, &mut normal)?;
        points::plain_linearise::<EDGE_BEHIND, LOCAL_BEHIND>(image, estimated, &mut normal)?;
        // Tangents are refused there.
        for pair in &image.observations.pairs {
            tangent::cost(image, pair, &mut scratch.tangent)?;
        }
        mapped(&normal, &scratch.map, &mut scratch.normal);
        return Some(());
    }
    let mut normal = ImageNormal::<LOCAL>::zeros();
    let columns = columns(model, places, image.observations.camera);
    if edges::allows(camera) {
        edges::linearise(image, &columns, &mut scratch.edges, &mut normal)?;
    } else {
        image.plain_contours::<EDGE, LOCAL>(estimated, &mut normal)?;
    }
    if edges::allows(camera) {
        let scratch = (&mut scratch.points, &mut scratch.edges);
        points::linearise(image, &columns, estimated, scratch, &mut normal)?;
    } else {
        points::plain_linearise::<EDGE, LOCAL>(image, estimated, &mut normal)?;
    }
    for pair in &image.observations.pairs {
        tangent::linearise(image, pair, &columns, &mut scratch.tangent, &mut normal)?;
    }
    mapped(&normal, &scratch.map, &mut scratch.normal);
    Some(())
}

/// Images whose equations exist at a time where threads form them.
const AT_A_TIME: usize = 64;

/// Gives the view and the equations of each image, or of those of one camera, to `add` in the order of the images.
fn each_image(
    model: &Model,
    places: &Places,
    state: &State,
    camera: Option<usize>,
    mut add: impl FnMut(usize, &MappedNormal),
) -> Option<()> {
    let wanted: Vec<&ImageObservations> =
        model.images.iter().filter(|i| camera.is_none_or(|c| i.camera == c)).collect();
    let cameras = cameras(model, state)?;
    let of = |scratch: &mut Scratch, o: &ImageObservations| {
        let mut image = SeenImage::through(model, state, o, cameras[o.camera]);
        image.paired = camera.is_none();
        linearised(model, places, state, &image, scratch)
    };
    if !threaded(&wanted) {
        let mut scratch = Scratch::default();
        for o in wanted {
            of(&mut scratch, o)?;
            add(o.view, &scratch.normal);
        }
        return Some(());
    }
    let memory = OwnMemory::<Scratch>::new();
    let mut each: Vec<MappedNormal> = (0..AT_A_TIME.min(wanted.len())).map(|_| MappedNormal::default()).collect();
    for some in wanted.chunks(AT_A_TIME) {
        let formed = |(o, normal): (&&ImageObservations, &mut MappedNormal)| {
            memory.with(|scratch| {
                of(scratch, o)?;
                std::mem::swap(&mut scratch.normal, normal);
                Some(())
            })
        };
        some.par_iter().zip(&mut each).map(formed).collect::<Option<()>>()?;
        some.iter().zip(&each).for_each(|(o, n)| add(o.view, n));
    }
    Some(())
}

/// View and equations of each image, in their order.
pub(super) fn of_each_image(model: &Model, places: &Places, state: &State) -> Option<Vec<(usize, MappedNormal)>> {
    of_each_image_in(model, places, state, |_| state)
}

/// The same with a state for each image, as for [`cost_in`].
pub(super) fn of_each_image_in<'a>(
    model: &'a Model,
    places: &Places,
    cameras_of: &State,
    state: impl Fn(&ImageObservations) -> &'a State + Sync,
) -> Option<Vec<(usize, MappedNormal)>> {
    let wanted: Vec<&ImageObservations> = model.images.iter().collect();
    let cameras = cameras(model, cameras_of)?;
    let memory = OwnMemory::<Scratch>::new();
    let of = |o: &&ImageObservations| {
        memory.with(|scratch| {
            let own = state(o);
            linearised(model, places, own, &SeenImage::through(model, own, o, cameras[o.camera]), scratch)?;
            Some((o.view, std::mem::take(&mut scratch.normal)))
        })
    };
    gathered(threaded(&wanted), &wanted, of)
}

/// Normal equations of all images, or of those of one camera, without facts. Summed in the order of the images.
pub(super) fn linearise(
    model: &Model,
    places: &Places,
    state: &State,
    camera: Option<usize>,
) -> Option<NormalEquations> {
    let mut equations = NormalEquations::zeros(&places.layout());
    let mut pairs = Pairs::of(Some(places));
    each_image(model, places, state, camera, |view, n| {
        add_mapped(&mut equations, view, n, places.offsets);
        pairs.add(&mut equations, view, n, model.loss);
    })?;
    mirror(&mut equations);
    Some(equations)
}

/// Those of images at hand.
pub(super) fn summed<'a>(
    model: &Model,
    places: &Places,
    images: impl Iterator<Item = &'a (usize, MappedNormal)>,
) -> NormalEquations {
    let mut equations = NormalEquations::zeros(&places.layout());
    let mut pairs = Pairs::of(Some(places));
    images.for_each(|(view, n)| {
        add_mapped(&mut equations, *view, n, places.offsets);
        pairs.add(&mut equations, *view, n, model.loss);
    });
    mirror(&mut equations);
    equations
}

/// Those of images at hand with one block per disc.
pub(super) fn summed_by_disc<'a>(
    by: &ByDisc,
    images: impl Iterator<Item = &'a (usize, MappedNormal)>,
) -> NormalEquations {
    let mut equations = NormalEquations::zeros(&by.layout());
    images.for_each(|(view, n)| by.add(&mut equations, *view, n));
    equations
}

/// Those of all images with one block per disc.
pub(super) fn linearise_by_disc(model: &Model, places: &Places, by: &ByDisc, state: &State) -> Option<NormalEquations> {
    let mut equations = NormalEquations::zeros(&by.layout());
    each_image(model, places, state, None, |view, n| by.add(&mut equations, view, n))?;
    Some(equations)
}

/// Right-hand side of the geodesic acceleration from the states a part `h` of the step before and behind; of contours and
/// points only (facts and tangent features bend little).
pub(super) fn bend(model: &Model, places: &Places, states: [&State; 3], h: f64) -> Option<Gradient> {
    let all = [cameras(model, states[0])?, cameras(model, states[1])?, cameras(model, states[2])?];
    let memory = OwnMemory::<Scratch>::new();
    let of = |o: &&ImageObservations| {
        let seen = [0, 1, 2].map(|k| SeenImage::through(model, states[k], o, all[k][o.camera]));
        let bend = memory.with(|scratch| bend_of(model, places, states[1], &seen, (h, scratch)))?;
        Some((bend, if places.ovals.is_some() { tie::oval_bends(&seen, h)? } else { vec![] }))
    };
    let images: Vec<&ImageObservations> = model.images.iter().collect();
    let each: Option<Vec<(Bend, Vec<(usize, [f64; 2])>)>> = gathered(threaded(&images), &images, of);
    let layout = places.layout();
    let blocks = layout.blocks.iter().map(|d| DVector::zeros(*d)).collect();
    let mut out = Gradient { global: DVector::zeros(layout.global), blocks };
    for (o, ((map, local, offsets), ovals)) in model.images.iter().zip(each?) {
        image_map::add_gradient(&mut out, o.view, &map, &local);
        if let Some(first) = places.offsets {
            for (disc, x) in offsets {
                (0..4).for_each(|k| out.global[first + 4 * disc + k] += x[k]);
            }
        }
        if let Some(first) = places.ovals {
            for (disc, x) in ovals {
                (0..2).for_each(|k| out.global[first + 2 * disc + k] += x[k]);
            }
        }
    }
    Some(out)
}

/// Unknowns of an image, the bend in its camera space (windows behind), and that of its discs.
type Bend = (Vec<MapColumn>, SVector<f64, LOCAL_BEHIND>, Vec<(usize, Vector4<f64>)>);

fn bend_of(
    model: &Model,
    places: &Places,
    state: &State,
    seen: &[SeenImage; 3],
    (h, scratch): (f64, &mut Scratch),
) -> Option<Bend> {
    let here = &seen[1];
    let mut map = vec![];
    image_map(model, places, state, here, &mut map);
    let (mut local, mut offsets) = (SVector::<f64, LOCAL_BEHIND>::zeros(), vec![]);
    let camera = &here.camera.camera;
    if camera.window().is_some() {
        plain_bend::<EDGE_BEHIND, LOCAL_BEHIND>(seen, h, &mut local, &mut offsets)?;
        points::plain_bend::<EDGE_BEHIND, LOCAL_BEHIND>(seen, h, &mut local, &mut offsets)?;
    } else {
        let mut in_air = SVector::<f64, LOCAL>::zeros();
        if edges::allows(camera) {
            let columns = columns(model, places, here.observations.camera);
            edges::bend(seen, &columns, h, &mut scratch.edges, (&mut in_air, &mut offsets))?;
        } else {
            plain_bend::<EDGE, LOCAL>(seen, h, &mut in_air, &mut offsets)?;
        }
        if edges::allows(camera) {
            let columns = columns(model, places, here.observations.camera);
            points::bend(seen, &columns, h, &mut scratch.bent_points, (&mut in_air, &mut offsets))?;
        } else {
            points::plain_bend::<EDGE, LOCAL>(seen, h, &mut in_air, &mut offsets)?;
        }
        local.fixed_rows_mut::<LOCAL>(0).copy_from(&in_air);
    }
    Some((map, local, offsets))
}

/// The bend of an image's contours, point by point.
pub(super) fn plain_bend<const E: usize, const L: usize>(
    seen: &[SeenImage; 3],
    h: f64,
    local: &mut SVector<f64, L>,
    offsets: &mut Vec<(usize, Vector4<f64>)>,
) -> Option<()> {
    let (o, loss) = (seen[1].observations, seen[1].model.loss);
    for d in &o.discs {
        let circles = [seen[0].circle(d.disc), seen[1].circle(d.disc), seen[2].circle(d.disc)];
        let b = contour::bend::<E>([&circles[0], &circles[1], &circles[2]], d, o.sigma_scale, loss, h)?;
        *local += seen[1].disc_map::<E, L>(d.disc).tr_mul(&b);
        offsets.push((d.disc, seen[1].offset_map::<E>().tr_mul(&b)));
    }
    Some(())
}

#[cfg(test)]
mod tests;
