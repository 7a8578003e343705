//! Scenes that come with the program.

/// Names and scene texts.
///
/// * `paper-table1`: the paper's set-up with its numbers as printed (tilt 2.8 degrees, f = 8067 px).
/// * `paper-table2`: the same with tilt and f that a 50 mm lens focused on the sheet really has (6.34 degrees, 8889 px).
/// * `paper-table3`: that, with the laser sheet off its nominal place.
/// * `bubbles`, `printed`: the two examples of the repository.
/// * `dot-grid`: a printed grid with ring marks. `two-level-plate`: a machined plate with square and triangle.
pub const PRESETS: [(&str, &str); 7] = [
    ("paper-table1", include_str!("presets/paper-table1.toml")),
    ("paper-table2", include_str!("presets/paper-table2.toml")),
    ("paper-table3", include_str!("presets/paper-table3.toml")),
    ("bubbles", include_str!("../../examples/bubbles/scene.toml")),
    ("printed", include_str!("../../examples/printed/scene.toml")),
    ("dot-grid", include_str!("presets/dot-grid.toml")),
    ("two-level-plate", include_str!("presets/two-level-plate.toml")),
];
