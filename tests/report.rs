//! The report: well-formed, complete, safe against hostile names; CSV; text. The page and an overlay of the made-up
//! scene are left in Cargo's scratch directory to be looked at.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod scene;

use roxmltree::{Document, ParsingOptions};
use scene::pictures;
use spivcal::image::GrayImage;
use spivcal::record::{
    Diagnosis, KeyQuantity, Known, MappingByLikelihood, OFF_ITSELF, OutlierReason, Prior, Record, ResidualTable,
    ViewInfluence,
};
use spivcal::report::{self, Level, OverlayInput, OverlayShapes};

fn parse(html: &str) -> Document<'_> {
    let options = ParsingOptions { allow_dtd: true, ..Default::default() };
    Document::parse_with_options(html, options).unwrap_or_else(|e| panic!("not well-formed: {e}"))
}

/// All text of the page, blanks folded.
fn words(document: &Document<'_>) -> String {
    let texts = document.descendants().filter(|n| n.is_text() && !n.parent().unwrap().has_tag_name("style"));
    let text: Vec<_> = texts.filter_map(|n| n.text()).collect();
    text.join(" ").split_whitespace().collect::<Vec<_>>().join(" ")
}

struct Page {
    images: Vec<(usize, usize, GrayImage, OverlayShapes)>,
    table: ResidualTable,
}

impl Page {
    fn new(views: std::ops::Range<usize>) -> Self {
        let table = pictures::residuals();
        let images = views
            .flat_map(|v| [(v, 0), (v, 1)])
            .map(|(v, c)| (v, c, pictures::image(c, v), pictures::shapes(c, v, &table)))
            .collect();
        Self { images, table }
    }
    fn html(&self, record: &Record) -> String {
        let overlays: Vec<_> = self
            .images
            .iter()
            .map(|(view, camera, image, shapes)| OverlayInput {
                view: *view,
                camera: *camera,
                image: image.view(),
                shapes,
            })
            .collect();
        report::write_html(record, &overlays, &self.table).unwrap()
    }
}

fn leave_to_look_at(name: &str, bytes: &[u8]) {
    std::fs::write(std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join(name), bytes).unwrap();
}

#[test]
fn the_page_is_well_formed_complete_and_loads_nothing() {
    let page = Page::new(0..scene::VIEWS);
    let html = page.html(&scene::record());
    leave_to_look_at("report.html", html.as_bytes());
    assert_eq!(html, page.html(&scene::record()), "equal inputs, equal bytes");
    let document = parse(&html);
    let text = words(&document);
    for view in 0..scene::VIEWS {
        assert!(text.contains(&format!("View {view}, camera left")), "view {view} is missing");
        assert!(text.contains(&format!("v{}_right.png", view + 1)));
    }
    for expected in [
        "Usable, but first read",
        "Tilt alpha of the right camera is known only from its prior.",
        "8889 ± 22",
        "6.34° ± 0.11°",
        "0.000° ± 0.031°",
        "the paper's homography",
        "rotations about the rig's x, y, z axes",
        "residual above 5 sigmas",
        "held",
        "prior 97 %",
        "left.cx_px left.beta_rad 0.9940",
        "examples/bubbles/rig.toml",
        "grey: target poses, green those in the sheet, each",
    ] {
        assert!(text.contains(expected), "{expected:?} is missing");
    }
    for node in document.descendants().filter(|n| n.is_element()) {
        assert!(!["script", "link", "iframe", "object"].contains(&node.tag_name().name()));
        for a in node.attributes().filter(|a| ["src", "href"].contains(&a.name())) {
            assert!(a.value().starts_with("data:image/jpeg;base64,") || a.value().starts_with('#'), "{}", a.value());
        }
    }
    assert_eq!(document.descendants().filter(|n| n.has_tag_name(("http://www.w3.org/2000/svg", "image"))).count(), 12);
    assert!(!html.contains("NaN") && !html.contains("inf "));
}

/// What is counted, and of what an rms is, agrees between the fit and its cameras.
#[test]
fn residuals_say_of_what_they_are() {
    let mut record = scene::record();
    for (c, (points, rms_px)) in record.cameras.iter_mut().zip([(6_000, 0.03), (2_000, 0.05)]) {
        (c.observations, c.edge_rms_px) = (points, Some(rms_px));
    }
    record.fit.observations = 8_000;
    let said = report::text(&record);
    for expected in ["0.03 px of 6000", "0.05 px of 2000", "0.0361 px", "8000 edge points"] {
        assert!(said.contains(expected), "{expected:?} is missing: {said}");
    }
    assert_eq!(said.matches("residual rms, places of discs").count(), 2, "{said}");
    assert_eq!(said.matches("residual rms, edge points").count(), 2, "{said}");
    record.fit.observations = 7_872;
    let said = report::text(&record);
    assert!(said.contains("7872: 8000 edge points, less 128 that went into the light"), "{said}");
    record.fit.observation_model = "bitangent".into();
    record.fit.observations = 96;
    assert!(report::text(&record).contains("96 of common tangents, from 8000 edge points"));
    // Cameras of another package state neither.
    for c in &mut record.cameras {
        (c.observations, c.edge_rms_px) = (0, None);
    }
    assert!(!report::text(&record).contains("residual rms, edge points"));
}

/// A page whose tables are wider than the window must not scroll as a whole: its sentences would leave the screen.
#[test]
fn every_table_scrolls_by_itself_and_words_break() {
    let html = Page::new(0..scene::VIEWS).html(&scene::record());
    let document = parse(&html);
    let tables: Vec<_> = document.descendants().filter(|n| n.has_tag_name("table")).collect();
    assert!(tables.len() > 6, "{}", tables.len());
    for table in &tables {
        let parent = table.parent().and_then(|p| p.attribute("class"));
        assert_eq!(parent, Some("wide"), "the table at {:?}", table.range());
        let heads = table.children().any(|n| n.has_tag_name("thead"));
        assert!(heads || table.attribute("class") == Some("facts"), "the table at {:?}", table.range());
    }
}

#[test]
fn every_picture_has_ids_of_its_own() {
    let page = Page::new(0..2);
    let html = page.html(&scene::record());
    let document = parse(&html);
    let mut ids: Vec<_> = document.descendants().filter_map(|n| n.attribute("id")).collect();
    let targets: Vec<_> =
        document.descendants().filter_map(|n| n.attribute("href")).filter_map(|h| h.strip_prefix('#')).collect();
    assert!(targets.iter().all(|t| ids.contains(t)), "a link leads nowhere");
    let n = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), n);
}

#[test]
fn hostile_names_are_only_text() {
    let evil = "<script>alert('x')</script>\"&]]>\u{1b}[31m";
    let mut record = scene::record();
    record.cameras[0].name = evil.into();
    record.provenance.rig_file = evil.into();
    record.provenance.options.insert(evil.into(), evil.into());
    record.provenance.images[0].path = evil.into();
    record.views[0].why_unused = evil.into();
    record.views[1].images.insert(evil.into(), evil.into());
    record.fit.undetermined.push(evil.into());
    record.fit.flags.push(evil.into());
    record.fit.termination = evil.into();
    record.fit.parameters[0].name = evil.into();
    record.covariance.names[4] = evil.into();
    record.target.kind = evil.into();
    let mut page = Page::new(0..1);
    page.images[0].3.labels[0].text = evil.into();
    page.images[0].3.rejected[0].reason = evil.into();
    let row = page.table.row(0).unwrap();
    page.table.push(&row, Some(evil));
    let html = page.html(&record);
    let document = parse(&html);
    assert!(document.descendants().all(|n| !n.has_tag_name("script")));
    assert!(!html.contains('\u{1b}'));
    assert!(words(&document).contains("<script>alert('x')</script>\"&]]>"));
    assert!(!report::text(&record).contains('\u{1b}'));
    let csv = report::residuals_csv(&record, &page.table);
    assert!(csv.lines().nth(1).unwrap().starts_with("0,\"<script>alert('x')</script>\"\"&]]>"), "{csv:.300}");
}

#[test]
fn a_poor_record_still_gives_a_page() {
    let mut record = scene::record();
    record.cameras.truncate(1);
    record.rig = None;
    record.sheet = None;
    record.scale = None;
    record.views.clear();
    record.fit.rms_px = f64::NAN;
    record.fit.newton_decrement = f64::INFINITY;
    record.fit.converged = false;
    record.fit.degrees_of_freedom = 0;
    record.covariance.names.clear();
    record.covariance.matrix.clear();
    record.cameras[0].sigma.f_px = f64::INFINITY;
    let html = report::write_html(&record, &[], &ResidualTable::default()).unwrap();
    let document = parse(&html);
    let text = words(&document);
    for expected in ["Do not use.", "8889.31 (sigma not determined)", "sheet = true", "No images were given"] {
        assert!(text.contains(expected), "{expected:?} is missing in {text}");
    }
    assert!(!text.contains("green those in the sheet"), "no pose is");
    assert!(!html.contains("NaN"), "{}", &html[html.find("NaN").unwrap() - 80..][..160]);
    assert!(report::text(&record).contains("DO NOT USE"));
}

/// Pixels of residuals where noise explains hundredths: nothing to be used, whatever converged.
#[test]
fn a_contradiction_is_not_called_usable() {
    let mut record = scene::record();
    (record.fit.converged, record.fit.rms_px, record.fit.sigma_scale) = (true, 2.98, 46.0);
    let said = report::text(&record);
    assert!(said.starts_with("DO NOT USE") && said.contains("contradict each other by 3 px (rms)"), "{said}");
    // Blurred and noisy images are not that.
    record.fit.sigma_scale = 1.2;
    assert!(!report::text(&record).starts_with("DO NOT USE"));
}

/// A sheet on which the cameras see its own target apart is not where that target stood.
#[test]
fn a_sheet_that_is_elsewhere_is_not_called_good() {
    let mut record = scene::record();
    record.sheet.as_mut().unwrap().disparity_rms_px = Some(74.9);
    let v = report::verdict(&record);
    assert!(v.level == Level::Bad && v.headline.contains("75 px (rms) apart on it"), "{v:?}");
    assert!(v.next.iter().any(|w| w.contains("in every view marked sheet = true")), "{v:?}");
    // Residuals of pixels let expect as much.
    record.fit.rms_px = 8.0;
    assert!(!report::text(&record).starts_with("DO NOT USE"));
}

/// A view of which nothing can be said has dashes; the change that is most significant has its own name.
#[test]
fn influences_have_names_or_dashes() {
    let mut record = scene::record();
    let nothing = |view: usize| ViewInfluence {
        view,
        sigma_growth: f64::NAN,
        sigma_growth_of: String::new(),
        lost: vec![],
        predicted_shift_sigmas: f64::NAN,
        shift_sigmas: f64::NAN,
        shift_of: String::new(),
        z: f64::NAN,
        z_of: String::new(),
        contradicts: false,
        words: "nothing can be said".into(),
    };
    let (shift_sigmas, shift_of, z, z_of) = (207.0, "angle of the sheet".into(), 5.9, "out-of-plane gain".into());
    let views = vec![nothing(0), ViewInfluence { shift_sigmas, shift_of, z, z_of, ..nothing(1) }];
    let diagnosis = Diagnosis { views, key_quantities: vec![], priors: vec![], model_tests: vec![], outliers: vec![] };
    record.fit.diagnosis = Some(diagnosis);
    let html = report::write_html(&record, &[], &ResidualTable::default()).unwrap();
    let text = words(&parse(&html));
    assert!(!text.contains("unknown ()") && !text.contains("unknown sigma"), "{text}");
    assert!(text.contains("207 sigma") && text.contains("5.9 (out-of-plane gain)"), "{text}");
}

/// Standard deviations that the views tell have a row where they are known; of many discs set aside the first are listed and the rest counted.
#[test]
fn what_the_views_tell_is_told_and_long_lists_say_that_they_go_on() {
    let mut record = scene::record();
    let key = |name: &str, unit: &str, sigma_by_views: f64| {
        let (name, unit) = (name.into(), unit.into());
        KeyQuantity { name, unit, value: 1474.31, sigma: 0.085, interval_95: None, sigma_by_views }
    };
    let aside = |row: i32| OutlierReason {
        view: 3,
        camera: "left".into(),
        disc: [9, row, 0],
        distance_px: 0.5,
        reason: "0.5 px from where the other discs expect it".into(),
    };
    let off_itself = |view: usize| OutlierReason {
        view,
        camera: "right".into(),
        disc: [1, 2, 0],
        distance_px: [0.7, 0.9, 0.8, 0.6][view],
        reason: format!(
            "{} px from where the other discs expect it, and off in 3 more view(s): {OFF_ITSELF}",
            [0.7, 0.9, 0.8, 0.6][view]
        ),
    };
    record.fit.diagnosis = Some(Diagnosis {
        key_quantities: vec![
            key("effective focal length", "px", 0.442),
            key("angle between the lens axes", "deg", 0.117),
            key("effective principal point", "px", f64::NAN),
        ],
        // A dot that is off in every view has one line.
        outliers: (0..4).map(off_itself).chain((0..42).map(aside)).collect(),
        ..Diagnosis::default()
    });
    let html = report::write_html(&record, &[], &ResidualTable::default()).unwrap();
    for text in [words(&parse(&html)), report::text(&record).split_whitespace().collect::<Vec<_>>().join(" ")] {
        assert!(text.contains("(1474.310 ± 0.085) px 0.44 px × 5.2"), "{text}");
        assert!(text.contains("1474.310° ± 0.085° 0.12° × 1.4"), "{text}");
        assert!(!text.contains("effective principal point"), "{text}");
        assert!(text.contains("disc 9, 38, 0: 0.5 px") && !text.contains("disc 9, 39, 0"), "{text}");
        assert!(
            text.contains("isc 1, 2, 0 in 4 images, furthest in view 1, camera right: 0.9 px from where"),
            "{text}"
        );
        assert_eq!(text.matches("isc 1, 2, 0").count(), 1, "{text}");
        assert!(text.contains("nd 3 more: all are in calibration.json"), "{text}");
    }
}

/// Numbers whose intervals are others than their standard deviations tell have a row, with what holds them.
#[test]
fn where_equations_bend_intervals_are_told() {
    let mut record = scene::record();
    let key = |name: &str, unit: &str, interval_95| {
        let (name, unit) = (name.into(), unit.into());
        KeyQuantity { name, unit, value: 530.26, sigma: 3.02, interval_95, sigma_by_views: f64::NAN }
    };
    record.fit.diagnosis = Some(Diagnosis {
        key_quantities: vec![
            key("principal point cx", "px", Some([Some(511.04), Some(536.18)])),
            key("angle between the lens axes", "deg", Some([Some(524.4), None])),
            key("focal length", "px", Some([Some(524.33), Some(536.18)])),
            key("distance of the sheet", "mm", None),
        ],
        ..Diagnosis::default()
    });
    let html = report::write_html(&record, &[], &ResidualTable::default()).unwrap();
    for text in [words(&parse(&html)), report::text(&record).split_whitespace().collect::<Vec<_>>().join(" ")] {
        assert!(text.contains("principal point cx (530.3 ± 3.0) px 524.3 to 536.2 511.0 to 536.2"), "{text}");
        assert!(text.contains("axes 530.3° ± 3.0° 524.3 to 536.2 524.4 to no end found"), "{text}");
        let section = text.split("does not tell how far").nth(1).unwrap();
        assert!(!section.contains("focal length (530.3") && !section.contains("sheet (530.3"), "{text}");
    }
}

/// Parameters that move together are listed, poses of views are not.
#[test]
fn poses_of_views_are_no_news() {
    let mut record = scene::record();
    record.covariance.names = ["left.f_px", "left.cx_px", "view0.rig_from_target.tz_mm", "view1.rig_from_target.tz_mm"]
        .map(String::from)
        .into();
    record.covariance.matrix = vec![vec![1.0; 4]; 4];
    let html = words(&parse(&report::write_html(&record, &[], &ResidualTable::default()).unwrap()));
    assert!(html.contains("left.f_px left.cx_px 1.0000") && !html.contains("rig_from_target"), "{html}");
}

/// What the views tell of measurements stands beside what is stated, and in the verdict and under the maps where they differ by more than their noise.
#[test]
fn what_the_views_tell_of_measurements_is_told() {
    let mut record = scene::record();
    for beyond_noise in [true, false] {
        record.mapping_uncertainty = Some(scene::mapping(beyond_noise));
        let html = words(&parse(&report::write_html(&record, &[], &ResidualTable::default()).unwrap()));
        let text = report::text(&record).split_whitespace().collect::<Vec<_>>().join(" ");
        for said in [&html, &text] {
            assert!(said.contains("as the views tell it"), "{said}");
            assert!(said.contains("disparity of the two cameras 0.13 px 0.13 px –"), "{said}");
            assert!(said.contains("error of w per w 0.16 % 0.16 % × 2.6"), "{said}");
            assert_eq!(said.contains("tell 3.3, 1.4 and 2.4 times as much for u, v and w"), beyond_noise, "{said}");
        }
        assert_eq!(html.contains("in % of w; the views tell 2.6 times as much"), beyond_noise, "{html}");
        assert!(!html.contains("NaN"), "{html}");
    }
    record.mapping_uncertainty.as_mut().unwrap().by_views = None;
    assert!(!report::text(&record).contains("as the views tell it"));
}

/// What the likelihood adds where equations bend stands in a column of its own, and in the verdict.
#[test]
fn what_the_likelihood_tells_of_measurements_is_told() {
    let mut record = scene::record();
    let mut mapping = scene::mapping(false);
    mapping.by_views = None;
    mapping.by_likelihood = Some(MappingByLikelihood {
        disparity_px: 0.312,
        in_plane_mm: 0.016,
        in_plane_scale: 0.0,
        out_of_plane_gain: f64::NAN,
        displacement: vec![vec![0.0024, 0.0, 0.0], vec![0.0; 3], vec![0.0, 0.0, 0.0012]],
    });
    record.mapping_uncertainty = Some(mapping);
    let html = words(&parse(&report::write_html(&record, &[], &ResidualTable::default()).unwrap()));
    let text = report::text(&record).split_whitespace().collect::<Vec<_>>().join(" ");
    for said in [&html, &text] {
        assert!(said.contains("at worst, as the likelihood tells it"), "{said}");
        assert!(said.contains("disparity of the two cameras 0.13 px 0.13 px 0.34 px"), "{said}");
        assert!(said.contains("place in the sheet 0.11 px (12 µm) 0.11 px (12 µm) 0.18 px (20 µm)"), "{said}");
        assert!(said.contains("error of u per u 0.1 % 0.1 % 0.26 %"), "{said}");
        assert!(said.contains("out-of-plane gain over in-plane scale 0.15 % 0.15 % not determined"), "{said}");
        assert!(
            said.contains("equations bend with these: their likelihood tells 1.1, 1 and 1.2 times as much"),
            "{said}"
        );
        assert!(said.contains("0.26 % of u") && said.contains("to 0.34 px (one sigma each)"), "{said}");
    }
    assert!(!html.contains("NaN"), "{html}");
}

#[test]
fn the_verdict_follows_the_record() {
    let mut good = scene::record();
    good.fit.undetermined.clear();
    good.fit.flags.clear();
    good.fit.outliers = 0;
    good.fit.near_null.clear();
    good.fit.parameters.retain(|p| p.known != Known::Prior);
    good.views[3].rms_px = good.views[2].rms_px.clone();
    let v = report::verdict(&good);
    assert_eq!(v.level, Level::Good);
    assert_eq!(v.open, ["Nothing: the images determine every number that was estimated."]);
    assert_eq!(v.next, ["Nothing has to be done."]);
    let mut open = good.clone();
    open.fit.undetermined.push("axis point cx of camera left is known only from its prior".into());
    let v = report::verdict(&open);
    assert_eq!(v.level, Level::Care);
    assert!(v.next.len() == 1 && v.next[0].contains("give it a prior in the rig file"), "{:?}", v.next);

    let v = report::verdict(&scene::record());
    assert_eq!(v.level, Level::Care);
    assert_eq!(v.open[0], "Tilt alpha of the right camera is known only from its prior.");
    assert!(
        v.next
            .iter()
            .any(|s| s
                == "Look at view 3, camera right: its residual of 0.071 px is 2.7 times the median of this camera."),
        "{:?}",
        v.next
    );

    let mut noisy = good.clone();
    noisy.fit.chi2 *= 9.0;
    let v = report::verdict(&noisy);
    assert_eq!(v.level, Level::Care);
    assert!(v.next[0].contains("3.03 times the noise") && v.next[0].contains("do not allow for it"), "{:?}", v.next);

    // Low for more reasons than one: bubbles full of smoke do not share noise.
    let mut low = good.clone();
    low.fit.degrees_of_freedom = 1000;
    for (chi2, said) in [(690.0, true), (710.0, false)] {
        low.fit.chi2 = chi2;
        let v = report::verdict(&low);
        let told = v.determined.iter().any(|s| s.contains("noise that neighbouring pixels share"));
        assert_eq!(told, said, "chi-square {chi2}: {:?}", v.determined);
        assert_eq!(report::text(&low).contains("which is low, because"), said);
    }
    // Where whole discs scatter more than their edge points it is for another reason.
    (low.fit.chi2, low.fit.sigma_scale) = (200.0, 6.2);
    assert!(report::text(&low).contains("sigmas were enlarged for whole discs, whose edge points scatter less"));

    let mut loose = good.clone();
    loose.fit.nullity = 2;
    let v = report::verdict(&loose);
    assert!(v.headline.contains("2 directions of the solution are not fixed"), "{}", v.headline);
    assert!(v.next.iter().any(|s| s.contains("a parallel shift does not help")));

    // A direction that a view keeps to itself needs no tilted views.
    let mut own = good.clone();
    own.fit.nullity = 1;
    let c = &mut own.covariance;
    let mut moved = vec![0.0; c.names.len()];
    moved.push(1.0);
    c.names.push("view1.rig_from_target.tz_mm".into());
    c.undetermined.extend(c.names.last().cloned());
    c.null_directions.push(moved);
    assert_eq!((own.covariance.loose_views(), own.covariance.shared_nullity()), (vec![1], 0));
    let v = report::verdict(&own);
    assert_eq!(v.level, Level::Care);
    assert!(!v.headline.contains("directions"), "{}", v.headline);
    assert!(!v.next.iter().any(|s| s.contains("a parallel shift does not help")), "{:?}", v.next);
    assert!(v.next.iter().any(|s| s.contains("View 1: what is open there harms nothing else")), "{:?}", v.next);
}

/// Noise that is cut off at 0 is told with what to do, once, from 2 % on.
#[test]
fn images_without_an_offset_are_told() {
    let mut record = scene::record();
    let told = |record: &Record| {
        let all = report::verdict(record).next;
        all.into_iter().filter(|s| s.contains("cut off at grey level 0")).collect::<Vec<_>>()
    };
    assert!(told(&record).is_empty());
    (record.provenance.images[1].cut_at_zero, record.provenance.images[4].cut_at_zero) = (0.018, 0.31);
    let words = told(&record);
    let path = &record.provenance.images[4].path;
    assert!(words.len() == 1 && words[0].starts_with("In 1 image noise beside the contours"), "{words:?}");
    assert!(words[0].contains(&format!("{path} the most, 31 %")) && words[0].contains("raise the camera's offset"));
}

/// What is known already is not asked for.
#[test]
fn few_views_are_told_what_else_would_help() {
    let mut record = scene::record();
    record.views.truncate(3);
    record.fit.diagnosis = None;
    let mut one = record.clone();
    one.views.truncate(1);
    assert!(report::verdict(&one).next.iter().any(|s| s.starts_with("One view can be checked against nothing")));
    let advice =
        |record: &Record| report::verdict(record).next.iter().find(|s| s.contains("parallel shift")).cloned().unwrap();
    assert!(advice(&record).starts_with("3 views can hardly be checked against each other"), "{}", advice(&record));
    let both = "A known focal length or the focus relation ([focus] in the rig file) helps as well.";
    assert!(advice(&record).ends_with(both), "{}", advice(&record));
    let mut stated = |name: &str| {
        let (name, unit, words) = (name.into(), "%".into(), "agrees".into());
        let [prior, prior_sigma, estimate, sigma_ratio, images_alone, images_alone_sigma, z] = [0.0; 7];
        let conflict = false;
        let own = Prior {
            name,
            stated: true,
            unit,
            prior,
            prior_sigma,
            estimate,
            sigma_ratio,
            images_alone,
            images_alone_sigma,
            z,
            conflict,
            words,
        };
        record.fit.diagnosis.get_or_insert_default().priors.push(own);
        advice(&record)
    };
    let advised = stated("distance of the sheet from the plane of focus, camera left");
    assert!(advised.ends_with(" A known focal length helps as well."), "{advised}");
    let advised = stated("focal length f of camera left");
    assert!(advised.ends_with(" A known focal length helps as well."), "one camera of two: {advised}");
    let advised = stated("focal length f of camera right");
    assert!(advised.ends_with("a parallel shift does not help."), "{advised}");
}

/// The truth of a simulated scene is no estimate of anybody.
#[test]
fn the_truth_is_called_so() {
    let scene = spivcal::simulate::Scene::preset("printed").unwrap();
    let record = Record::from_json(&scene.truth_json().unwrap(), "truth.json").unwrap();
    let v = report::verdict(&record);
    assert!(v.headline.starts_with("The true values of a simulated scene"), "{}", v.headline);
    assert!(v.open.iter().any(|s| s.contains("was chosen")) && v.level == Level::Care, "{:?}", v.open);
    assert_eq!(v.next, ["Nothing has to be done."]);
    // What another program found could be known better.
    let mut other = record.clone();
    other.fit.termination = "imported".into();
    let next = report::verdict(&other).next;
    assert!(next.iter().any(|s| s.starts_with("To know how certain they are")), "{next:?}");
}

#[test]
fn csv_has_its_columns_and_numbers_to_the_bit() {
    let (record, table) = (scene::record(), pictures::residuals());
    let csv = report::residuals_csv(&record, &table);
    let mut lines = csv.lines();
    let heads: Vec<_> = lines.next().unwrap().split(',').collect();
    assert_eq!(
        heads,
        [
            "view",
            "camera",
            "column",
            "row",
            "level",
            "feature",
            "u_px",
            "v_px",
            "du_px",
            "dv_px",
            "normal_px",
            "sigma_px",
            "weight",
            "outlier",
            "reason"
        ]
    );
    assert_eq!(lines.clone().count(), table.len());
    for (i, line) in lines.enumerate() {
        let fields: Vec<_> = line.split(',').collect();
        assert_eq!(fields.len(), heads.len(), "{line}");
        assert_eq!(fields[1], record.cameras[table.camera[i] as usize].name);
        assert_eq!(fields[6].parse::<f64>().unwrap().to_bits(), table.u_px[i].to_bits());
        assert_eq!(fields[10].parse::<f64>().unwrap().to_bits(), table.normal_px[i].to_bits());
        assert_eq!((fields[13], fields[14]), table.outlier(i).map_or(("0", ""), |r| ("1", r)));
    }
    assert_eq!(csv.matches(",1,residual above 5 sigmas").count(), 4);
    let mut table = ResidualTable::default();
    let row = pictures::residuals().row(0).unwrap();
    table.push(&spivcal::record::Residual { normal_px: f64::NAN, ..row }, None);
    assert!(report::residuals_csv(&record, &table).contains(",,0.025,1,0,\n"), "a number that does not exist is empty");
}

#[test]
fn the_text_fits_a_terminal_and_says_the_main_things() {
    let text = report::text(&scene::record());
    leave_to_look_at("show.txt", text.as_bytes());
    for expected in
        ["CARE: ", "focal length f", "(8889 ± 22) px [prior 6 %]", "Laser sheet", "view 5, in the sheet", "4 left out"]
    {
        assert!(text.contains(expected), "{expected:?} is missing in\n{text}");
    }
    assert!(text.lines().all(|l| l.chars().count() <= 130 && l.trim_end() == l), "{text}");
}

#[test]
fn the_overlay_keeps_the_size_of_the_image() {
    let table = pictures::residuals();
    let image = pictures::image(1, 3);
    let png = report::overlay_png(&image.view(), &pictures::shapes(1, 3, &table)).unwrap();
    leave_to_look_at("overlay.png", &png);
    let picture = image::load_from_memory(&png).unwrap();
    assert_eq!((picture.width(), picture.height()), (1024, 768));
}

/// Whoever exchanged all images of two cameras can see it nowhere but in where they stand.
#[test]
fn the_words_say_on_which_side_the_second_camera_stands() {
    let said = |r: &Record| report::text(r).split_whitespace().collect::<Vec<_>>().join(" ");
    let mut record = scene::record();
    for (shift_mm, words) in [
        ([700.0, 10.0, 0.0], "camera right to the right of camera left as its images show it"),
        ([-700.0, 10.0, 0.0], "camera right to the left of camera left"),
        ([10.0, 700.0, 0.0], "camera right below camera left"),
        ([10.0, -700.0, 0.0], "camera right above camera left"),
    ] {
        let pose = &mut record.cameras[1].cam_from_rig;
        pose.translation_mm = std::array::from_fn(|a| -(0..3).map(|b| pose.rotation[a][b] * shift_mm[b]).sum::<f64>());
        let said = said(&record);
        assert!(said.contains(words), "{words}: {said}");
    }
}
