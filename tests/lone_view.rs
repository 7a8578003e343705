//! A view with a gauge of its own: two discs of unknown size that one camera alone sees may be as far away and as large as they like. That is
//! said, of this view alone, and nothing else is the worse for it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod rig_scene;

use rig_scene::{Parts, Problem, given_sigmas};
use spivcal::bundle::{NamedCovariance, adjust, named_covariance};

/// The covariance where the second camera does not see some views.
fn covariance(parts: &Parts, lone: &[usize]) -> NamedCovariance {
    let mut scene = parts.scene();
    scene.model.images.retain(|i| i.camera == 0 || !lone.contains(&i.view));
    let out = adjust(&scene.model, scene.truth.clone(), &given_sigmas(), &mut |_| true);
    assert!(out.cost < 1e-9, "the truth is a minimum on exact contours, cost {}", out.cost);
    named_covariance(&out).unwrap()
}

/// Names of view `v` that are lost.
fn lost(c: &NamedCovariance, v: usize) -> Vec<&str> {
    let own = |n: &&str| n.starts_with(&format!("view{v}."));
    c.names.iter().zip(&c.determined).filter(|(_, d)| !**d).map(|(n, _)| n.as_str()).filter(own).collect()
}

#[test]
fn it_is_said_of_the_view_and_harms_nothing_else() {
    let parts = Problem::of("B").unwrap().parts;
    let lone = covariance(&parts, &[3, 5]);
    assert_eq!((lone.nullity, lone.shared_nullity()), (2, 0));
    for v in [3, 5] {
        let names = ["rig_from_target.tz_mm", "spacing_mm", "radius0_mm", "radius1_mm"];
        let found = lost(&lone, v);
        assert!(names.iter().all(|n| found.contains(&format!("view{v}.{n}").as_str())), "{found:?}");
        assert!(!found.iter().any(|n| n.contains("rx_rad") || n.contains("ry_rad")), "the turn is known: {found:?}");
        // One direction, along which all lengths grow by the same part.
        let d =
            lone.null_directions.column_iter().find(|d| d[lone.index(&format!("view{v}.spacing_mm")).unwrap()] != 0.0);
        let d = d.unwrap();
        let part = |k: usize| {
            let name = ["spacing_mm", "radius0_mm", "radius1_mm"][k];
            d[lone.index(&format!("view{v}.{name}")).unwrap()] / parts.views[v].shape_mm[k]
        };
        assert!((part(1) / part(0) - 1.0).abs() < 1e-6 && (part(2) / part(0) - 1.0).abs() < 1e-6);
        let z = d[lone.index(&format!("view{v}.rig_from_target.tz_mm")).unwrap()];
        assert!((z / parts.views[v].rig_from_target.translation_mm.z / part(0) - 1.0).abs() < 1e-6);
    }
    let words = "place and size of the targets of views 3 and 5: not determined, and no other number depends on it";
    assert_eq!(lone.undetermined, [words]);

    // A length of each of these views settles them; a gauge has no part in any other number, whose sigmas stay.
    let mut known = parts.clone();
    [3, 5].iter().for_each(|v| known.knows(*v, 0));
    let known = covariance(&known, &[3, 5]);
    assert_eq!((known.nullity, known.undetermined.len()), (0, 0));
    let mut compared = 0;
    for name in lone.names.iter().filter(|n| !n.starts_with("view3.") && !n.starts_with("view5.")) {
        let (a, b) = (lone.sigma(name).unwrap(), known.sigma(name).unwrap());
        assert!((a - b).abs() <= 1e-6 * b, "{name}: {a} {b}");
        compared += usize::from(b > 0.0);
    }
    assert!(compared > 150, "{compared}");
    for v in [3, 5] {
        let name = format!("view{v}.rig_from_target.rx_rad");
        assert!((lone.sigma(&name).unwrap() / known.sigma(&name).unwrap() - 1.0).abs() < 1e-6, "{name}");
    }
}

/// Where lengths of the rig are open, too, both are said.
#[test]
fn the_scale_of_the_rig_is_another_matter() {
    let mut parts = Problem::of("B").unwrap().parts;
    parts.facts.clear();
    let c = covariance(&parts, &[3]);
    assert_eq!((c.nullity, c.shared_nullity()), (2, 1));
    assert!(c.sigma("right.cam_from_rig.tx_mm").is_none() && c.sigma("view4.spacing_mm").is_none());
    assert!(
        c.undetermined.iter().any(|w| w.starts_with("shift along x") && w.contains("camera right")),
        "{:#?}",
        c.undetermined
    );
    // The view follows the rig's scale or its own.
    assert!(!lost(&c, 3).is_empty());
    let own = "place and size of the target of view 3: not determined, and no other number depends on it";
    assert!(c.undetermined.iter().any(|w| w == own), "{:#?}", c.undetermined);
    assert_eq!(c.undetermined.iter().filter(|w| w.contains("no other number")).count(), 1);
    assert!(c.sigma("left.f_px").is_some());
}
