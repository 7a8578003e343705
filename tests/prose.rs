//! What is written about the program is true: commands, exit codes, defaults, versions, files named.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use spivcal::error::{Error, Insufficient, Invalid, Unusable};
use spivcal::rig_file::{Focus, RigDescription};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

fn read(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn help(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_spivcal")).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "spivcal {arguments:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Commands that the program itself lists.
fn commands() -> BTreeSet<String> {
    let text = help(&["--help"]);
    let list = text.split("Commands:").nth(1).unwrap().split("Options:").next().unwrap();
    let names = list.lines().filter_map(|l| l.strip_prefix("  ")?.split(' ').next().map(str::to_string));
    names.filter(|n| !n.is_empty() && n != "help").collect()
}

/// Words after `spivcal ` or `cargo run --release -- ` in code of a Markdown text.
fn invocations(text: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let fenced = text.lines().filter_map(|l| l.strip_prefix("    "));
    let inline = text.split('`').skip(1).step_by(2);
    for code in fenced.chain(inline) {
        for start in ["spivcal ", "cargo run --release -- "] {
            if let Some(words) = code.trim().strip_prefix(start) {
                found.push(words.split_whitespace().map(str::to_string).collect());
            }
        }
    }
    found
}

fn documents() -> Vec<(String, String)> {
    let mut names = ["README.md", "docs/measurements.md", "docs/guide.md"].map(str::to_string).to_vec();
    names.extend(
        ["bubbles", "printed", "vortex", "dice", "piv-challenge-4e"].map(|e| format!("examples/{e}/README.md")),
    );
    names.into_iter().map(|n| (n.clone(), read(&n))).collect()
}

#[test]
fn commands_in_the_documents_exist_and_their_options_too() {
    let known = commands();
    for (name, text) in documents() {
        for words in invocations(&text) {
            assert!(known.contains(&words[0]), "{name}: spivcal {words:?} is no command");
            let help = help(&[&words[0], "--help"]);
            for option in words.iter().filter(|w| w.starts_with('-')) {
                let stands = help.split([' ', ',', '\n']).any(|w| w == option);
                assert!(stands, "{name}: {} has no option {option}", words[0]);
            }
            for file in words.iter().filter(|w| w.starts_with("examples/") && w.ends_with(".toml")) {
                read(file);
            }
        }
    }
}

/// Text of all source files, with strings that run over lines in one piece.
fn sources(folder: &Path) -> String {
    let mut out = String::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            out += &sources(&entry);
        } else if entry.extension().is_some_and(|e| e == "rs") {
            let text = std::fs::read_to_string(&entry).unwrap();
            out.extend(
                text.lines().map(|l| l.trim_start().strip_suffix('\\').map_or(format!("{l}\n"), str::to_string)),
            );
        }
    }
    out
}

#[test]
fn messages_and_pictures_of_the_guide_exist() {
    let (guide, root) = (read("docs/guide.md"), Path::new(env!("CARGO_MANIFEST_DIR")));
    let sources = sources(&root.join("src"));
    let messages: Vec<&str> = guide.lines().filter_map(|l| l.strip_prefix("| \"")?.split('"').next()).collect();
    assert!(messages.len() > 10);
    for message in messages {
        assert!(sources.contains(message), "docs/guide.md: the program never says \"{message}\"");
    }
    for picture in guide.split("](images/").skip(1).filter_map(|t| t.split(')').next()) {
        assert!(root.join("docs/images").join(picture).is_file(), "docs/guide.md: {picture}");
    }
}

#[test]
fn the_table_of_commands_is_that_of_the_program() {
    let readme = read("README.md");
    let rows = readme.lines().filter_map(|l| l.strip_prefix("| `spivcal ")?.split(' ').next());
    assert_eq!(rows.map(str::to_string).collect::<BTreeSet<_>>(), commands());
}

#[test]
fn the_checker_of_commands_sees_them() {
    let text = "Run\n\n    cargo run --release -- calibrate a.toml -o x\n\nor `spivcal show C.json` and `./check`.\n";
    assert_eq!(invocations(text), [vec!["calibrate", "a.toml", "-o", "x"], vec!["show", "C.json"]]);
}

#[test]
fn exit_codes_are_those_of_the_errors() {
    let families: [(Error, u8); 4] = [
        (Unusable::NotConverged { reason: "x".into(), decrement: 1.0, wanted: 0.1, besides: String::new() }.into(), 3),
        (Invalid::Contradiction("x".into()).into(), 2),
        (Insufficient::Degenerate("x".into()).into(), 3),
        (Error::Bug("x".into()), 4),
    ];
    for (error, code) in families {
        assert_eq!(error.exit_code(), code);
    }
    let readme = read("README.md");
    let words = ["done", "done, but flagged", "bad input", "not enough or degenerate data", "internal error"];
    for (code, word) in words.iter().enumerate() {
        assert!(readme.contains(&format!("| {code} | {word}")), "README: exit code {code}");
        assert!(help(&["--help"]).contains(&format!("{code} {word}")), "--help: exit code {code}");
    }
}

/// Default of a key in the table of the module `rig_file`.
fn documented_default(key: &str) -> String {
    let text = read("src/rig_file.rs");
    let row = text
        .lines()
        .filter_map(|l| l.strip_prefix("//! | "))
        .find(|l| l.split('|').next().is_some_and(|cell| cell.trim().ends_with(&format!("`{key}`"))))
        .unwrap_or_else(|| panic!("{key} is not in the table of rig_file"));
    row.split('|').nth(2).unwrap().trim().trim_matches('`').to_string()
}

#[test]
fn writing_the_documented_defaults_changes_nothing() {
    let rig = |target: &str, focus: &str, rest: &str, view: &str| {
        let camera = |n: &str| format!("[[camera]]\nname = \"{n}\"\npixel_pitch_mm = 0.01\nfocal_length_mm = 50\n");
        let text = format!(
            "{}{}[target]\nkind = \"two-discs\"\nspacing_mm = 26\n{target}\n[focus]\n{focus}\n[solve]\n{rest}\n\
             [[view]]\na = \"1.png\"\nb = \"2.png\"\nsheet = true\n[[view]]\na = \"3.png\"\n{view}\n",
            camera("a"),
            camera("b")
        );
        let mut job = RigDescription::parse(&text, "rig.toml").unwrap();
        job.text.clear();
        job.views.iter_mut().for_each(|v| v.line = 0);
        job
    };
    let key = |k: &str| format!("{k} = {}\n", documented_default(k));
    let stated = rig(
        &(key("polarity") + &key("adjust")),
        &(key("tilt_sigma_deg") + &key("distance_sigma")),
        &(key("observations") + &key("loss") + &key("estimate")),
        &key("sheet"),
    );
    assert_eq!(stated, rig("", "", "", ""));
    assert_eq!(documented_default("tilt_sigma_deg").parse(), Ok(Focus::DEFAULT_TILT_SIGMA_DEG));
    assert_eq!(documented_default("distance_sigma").parse(), Ok(Focus::DEFAULT_DISTANCE_SIGMA));
}

#[test]
fn versions_agree() {
    let (cargo, readme) = (read("Cargo.toml"), read("README.md"));
    let field = |name: &str| {
        let line = cargo.lines().find_map(|l| l.strip_prefix(&format!("{name} = \""))).unwrap();
        line.trim_end_matches('"').to_string()
    };
    let (version, rust) = (field("version"), field("rust-version"));
    assert!(read("CHANGELOG.md").contains(&format!("## [{version}]")), "CHANGELOG.md lacks {version}");
    assert!(help(&["--version"]).contains(&version));
    assert!(readme.contains(&format!("{rust} or newer")), "README.md: Rust {rust}");
    assert!(read("check").contains(&format!("Rust {rust} or newer")), "check: Rust {rust}");
}

#[test]
fn every_rig_file_of_the_examples_can_be_read() {
    for example in ["bubbles", "printed", "vortex", "dice", "piv-challenge-4e"] {
        let name = format!("examples/{example}/rig.toml");
        let job = RigDescription::parse(&read(&name), &name).unwrap();
        assert_eq!(job.cameras.len(), 2);
        assert!(read("README.md").contains(&format!("`examples/{example}`")), "{example} is not in README.md");
    }
}

#[test]
fn examples_of_others_name_every_file_with_its_sum() {
    for example in ["dice", "piv-challenge-4e"] {
        let name = format!("examples/{example}/rig.toml");
        let (job, readme) =
            (RigDescription::parse(&read(&name), &name).unwrap(), read(&format!("examples/{example}/README.md")));
        for image in job.views.iter().flat_map(|v| v.images.iter().flatten()) {
            let row = readme.lines().find(|l| l.contains(&format!("`{image}`"))).unwrap_or_else(|| panic!("{image}"));
            let sum = row.split('`').nth(3).unwrap();
            assert!(sum.len() == 64 && sum.bytes().all(|b| b.is_ascii_hexdigit()), "{image}: {sum}");
            let folder = Path::new(&name).parent().unwrap();
            assert!(!Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join(image).exists(), "{image} is not ours");
        }
        for word in ["repository:", "commit:", "path:", "licence"] {
            assert!(readme.contains(word), "{example}: {word}");
        }
    }
}
