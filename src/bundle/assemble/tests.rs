//! Threads change no bit.

use super::*;
use crate::bundle::rig_scene::{Grid, Scene, tilted_camera};
use rayon::ThreadPoolBuilder;

const DOTS: Grid = Grid { columns: 10, rows: 6, pitch_mm: 3.0, radius_mm: 0.9, print_error_mm: 0.01, turn: 1.0 };

/// More images than exist at a time, and more points than are worth threads: each image six times.
fn scene(estimated: bool) -> (Model, State) {
    let cameras = vec![tilted_camera(-0.1107, 0.01), tilted_camera(0.1107, -0.02)];
    let mut scene = Scene::with_grid_unseen(4, cameras, DOTS, estimated).seen_as_points(4);
    let once = scene.model.images.clone();
    (0..5).for_each(|_| scene.model.images.extend(once.iter().cloned()));
    let state = scene.perturbed_by(4, 0.1);
    (scene.model, state)
}

fn bits_of(e: &NormalEquations) -> Vec<u64> {
    let blocks = e.blocks.iter().flat_map(|b| b.h_vv.iter().chain(b.h_vg.iter()).chain(b.b_v.iter()));
    [e.cost].iter().chain(e.h_gg.iter()).chain(e.b_g.iter()).chain(blocks).map(|x| x.to_bits()).collect()
}

/// All that threads have a part in.
fn bits(model: &Model, states: [&State; 3]) -> Vec<Vec<u64>> {
    let places = Places::of(model);
    let whole = linearise(model, &places, states[1], None).unwrap();
    let each = of_each_image(model, &places, states[1]).unwrap();
    let again = summed(model, &places, each.iter());
    let gradient = bend(model, &places, states, 0.1).unwrap();
    let bent = gradient.global.iter().chain(gradient.blocks.iter().flat_map(|b| b.iter()));
    vec![
        bits_of(&whole),
        bits_of(&again),
        bent.map(|x| x.to_bits()).collect(),
        vec![cost(model, states[1]).unwrap().to_bits()],
    ]
}

#[test]
fn threads_change_no_bit() {
    for estimated in [false, true] {
        let (model, state) = scene(estimated);
        assert!(model.images.len() > AT_A_TIME);
        let (before, behind) = scene_states(&model, &state);
        let states = [&before, &state, &behind];
        let alone = bits(&model, states);
        assert_eq!(alone[0], alone[1], "sums of images at hand");
        for threads in [1, 2, 3] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                assert_eq!(threaded(&model.images.iter().collect::<Vec<_>>()), threads > 1);
                assert!(bits(&model, states) == alone, "{threads} threads");
            });
        }
    }
}

/// States a little before and behind one: every view turned about its own axes.
fn scene_states(model: &Model, state: &State) -> (State, State) {
    let problem = crate::bundle::problem(model);
    let side = |h: f64| {
        let mut step = crate::solve::Problem::scales(&problem, state);
        step.global *= 1e-3 * h;
        step.blocks.iter_mut().for_each(|b| *b *= 1e-3 * h);
        crate::solve::Problem::retract(&problem, state, &step).unwrap()
    };
    (side(-1.0), side(1.0))
}
