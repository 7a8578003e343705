//! The committed C headers are those of the functions in `src/ffi`.
//!
//! `SPIVCAL_WRITE_HEADERS=1 cargo test --test c_header` writes them anew; without it a difference is a failure.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use cbindgen::{Builder, Config, DocumentationStyle, Language, Style};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once};

/// Files with exported functions or constants, in the order of the header.
const FILES: [&str; 12] = [
    "abi.rs",
    "keys.rs",
    "rig_keys.rs",
    "context.rs",
    "image.rs",
    "detection.rs",
    "rig.rs",
    "rig_removal.rs",
    "job.rs",
    "calibration.rs",
    "mapping.rs",
    "velocity.rs",
];

/// Types that a signature may have; a pointer to them, one level, is allowed too.
const TYPES: [&str; 9] = ["int32_t", "uint64_t", "uint32_t", "uint8_t", "uint16_t", "float", "double", "char", "void"];

const CONTRACT: &str = include_str!("../src/ffi/contract.txt");

static WARNINGS: Mutex<Vec<String>> = Mutex::new(Vec::new());
static LOGGER: Collector = Collector;

/// What cbindgen complains about arrives as log records.
struct Collector;

impl log::Log for Collector {
    fn enabled(&self, _: &log::Metadata) -> bool {
        true
    }
    fn log(&self, record: &log::Record) {
        let text = record.args().to_string();
        // What is not `pub` is not part of the interface: that it is left out is no complaint.
        if record.level() <= log::Level::Warn && !text.ends_with("(not `pub`).") {
            WARNINGS.lock().unwrap().push(text);
        }
    }
    fn flush(&self) {}
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn generate(files: &[PathBuf]) -> (String, Vec<String>) {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        log::set_logger(&LOGGER).unwrap();
        log::set_max_level(log::LevelFilter::Warn);
    });
    let mut config = Config {
        language: Language::C,
        header: Some(CONTRACT.trim_end().to_string()),
        include_guard: Some("SPIVCAL_H".into()),
        no_includes: true,
        sys_includes: vec!["stdint.h".into()],
        cpp_compat: true,
        documentation: true,
        documentation_style: DocumentationStyle::Doxy,
        style: Style::Type,
        line_length: 110,
        ..Config::default()
    };
    config.function.sort_by = None;
    config.constant.sort_by = None;
    let mut out = Vec::new();
    // The collector is one for the process: tests that generate take turns.
    static TURN: Mutex<()> = Mutex::new(());
    let turn = TURN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    WARNINGS.lock().unwrap().clear();
    let builder = files.iter().fold(Builder::new().with_config(config), |b, f| b.with_src(f));
    builder.generate().unwrap().write(&mut out);
    let warnings = WARNINGS.lock().unwrap().clone();
    drop(turn);
    // C90 knows no comments of this kind.
    let text = String::from_utf8(out).unwrap().replace("  // __cplusplus", "").replace(" // __cplusplus", "");
    (text.replace("}  // extern \"C\"", "}").replace("} // extern \"C\"", "}"), warnings)
}

fn header() -> String {
    let files: Vec<PathBuf> = FILES.iter().map(|f| root().join("src/ffi").join(f)).collect();
    let (text, warnings) = generate(&files);
    assert!(warnings.is_empty(), "cbindgen warns: {warnings:#?}");
    text
}

/// LabVIEW's names of the types (those of its extcode.h), which its import wizard maps to the right terminals.
const LABVIEW_TYPES: [(&str, &str, &str); 7] = [
    ("uint64_t", "uInt64", "unsigned long long"),
    ("uint32_t", "uInt32", "unsigned int"),
    ("uint16_t", "uInt16", "unsigned short"),
    ("uint8_t", "uInt8", "unsigned char"),
    ("int32_t", "int32", "int"),
    ("double", "float64", "double"),
    ("float", "float32", "float"),
];

/// The same functions for LabVIEW's import wizard: its type names, one declaration per line, nothing to include.
fn labview(header: &str) -> String {
    let mut out = String::from(
        "/* spivcal for LabVIEW: Tools > Import > Shared Library. The same functions as spivcal.h in LabVIEW's type names, one\n   \
         declaration per line, nothing to include. Generated with spivcal.h; what the functions do is said there, the constants\n   \
         and a recipe are in ffi_examples/labview.md. */\n\n\
         #ifndef SPIVCAL_LABVIEW_H\n#define SPIVCAL_LABVIEW_H\n\n",
    );
    for (_, name, c) in LABVIEW_TYPES.iter().rev() {
        out.push_str(&format!("typedef {c} {name};\n"));
    }
    out.push_str("\n#ifdef __cplusplus\nextern \"C\" {\n#endif\n");
    for line in declarations(header) {
        // From the widest name on: "int32_t" is part of "uint32_t", "float" of "float64".
        let spelled = LABVIEW_TYPES.iter().fold(line, |l, (from, to, _)| replace_word(&l, from, to));
        out.push_str(&spelled);
        out.push('\n');
    }
    out.push_str("#ifdef __cplusplus\n}\n#endif\n\n#endif\n");
    out
}

fn replace_word(text: &str, word: &str, by: &str) -> String {
    let joins = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find(word) {
        let end = at + word.len();
        let whole = !joins(rest[..at].chars().next_back()) && !joins(rest[end..].chars().next());
        out.push_str(&rest[..at]);
        out.push_str(if whole { by } else { word });
        rest = &rest[end..];
    }
    out + rest
}

/// How LabVIEW's Call Library Function Node takes a parameter: terminal, and how it is passed.
fn terminal(declaration: &str, parameter: &str) -> (String, &'static str) {
    let kind = parameter.replace("const ", "");
    let word = kind.split([' ', '*']).next().unwrap();
    let name = match word {
        "uint64_t" => "Unsigned 64-bit Integer",
        "uint32_t" => "Unsigned 32-bit Integer",
        "uint16_t" => "Unsigned 16-bit Integer",
        "uint8_t" => "Unsigned 8-bit Integer",
        "int32_t" => "Signed 32-bit Integer",
        "float" => "4-byte Single",
        "double" => "8-byte Double",
        other => other,
    };
    // Many points at once, buffers and pictures are arrays; other pointers are single results.
    let picture = ["buffer", "data", "grey", "seen"].iter().any(|name| parameter.ends_with(name));
    let many = declaration.contains("uint64_t count,") || picture;
    match (word, parameter.contains('*')) {
        ("char", _) if parameter.contains("const") => ("String".into(), "C String Pointer, Constant"),
        ("char", _) => ("String, Minimum Size = capacity".into(), "C String Pointer"),
        (_, false) => (format!("Numeric, {name}"), "Value"),
        (_, true) if many && parameter.contains("const") => (format!("Array, {name}"), "Array Data Pointer, Constant"),
        (_, true) if many => (format!("Array, {name}, preallocated"), "Array Data Pointer"),
        (_, true) => (format!("Numeric, {name}"), "Pointer to Value"),
    }
}

/// The recipe for LabVIEW: words that are kept by hand, and tables made from the header.
fn labview_recipe(header: &str) -> String {
    let mut out = include_str!("../src/ffi/labview.txt").to_string();
    out.push_str("\n## Nodes\n\nEvery node: calling convention C, thread *Run in any thread*, return type *Signed 32-bit Integer*.\n");
    for line in declarations(header) {
        let (head, arguments) = line.trim_end_matches(';').trim_end_matches(')').split_once('(').unwrap();
        out.push_str(&format!("\n### {}\n\n", head.rsplit_once(' ').unwrap().1));
        if arguments == "void" {
            out.push_str("No parameters; the return value is a number, not a status.\n");
            continue;
        }
        out.push_str("| parameter | type | pass |\n|---|---|---|\n");
        for parameter in arguments.split(',').map(str::trim) {
            let (kind, pass) = terminal(&line, parameter);
            let name = parameter.rsplit([' ', '*']).next().unwrap();
            out.push_str(&format!("| `{name}` | {kind} | {pass} |\n"));
        }
    }
    out.push_str("\n## Constants\n\nWhat they mean is said in `spivcal.h`.\n\n| name | number |\n|---|---|\n");
    for line in header.lines().filter_map(|l| l.strip_prefix("#define ")) {
        if let Some((name, value)) = line.split_once(' ') {
            out.push_str(&format!("| `{name}` | {} |\n", value.trim()));
        }
    }
    out
}

/// Declarations of functions, each on one line.
fn declarations(header: &str) -> Vec<String> {
    let mut code = String::new();
    let mut rest = header;
    while let Some(start) = rest.find("/*") {
        code.push_str(&rest[..start]);
        rest = rest[start..].split_once("*/").unwrap().1;
    }
    code.push_str(rest);
    let lines = code.lines().filter(|l| !l.trim_start().starts_with('#') && !l.contains("extern \"C\""));
    let flat = lines.collect::<Vec<_>>().join(" ");
    flat.split(';')
        .map(|d| d.split_whitespace().collect::<Vec<_>>().join(" "))
        .filter(|d| d.contains('('))
        .map(|d| format!("{d};"))
        .collect()
}

/// What is wrong with the types of a declaration.
fn faults(declaration: &str) -> Vec<String> {
    let (head, arguments) = declaration.trim_end_matches(';').trim_end_matches(')').split_once('(').unwrap();
    let mut faults = Vec::new();
    let (result, name) = head.rsplit_once(' ').unwrap();
    if result != "int32_t" || !name.starts_with("spivcal_") {
        faults.push(format!("{head}: expected int32_t spivcal_..."));
    }
    for argument in arguments.split(',') {
        let words = argument.replace("const ", "");
        let stars = words.matches('*').count();
        let kind = words.trim().split([' ', '*']).next().unwrap();
        if stars > 1 || !TYPES.contains(&kind) || (kind == "void" && words.trim() != "void") || argument.contains('[') {
            faults.push(format!("{name}: {argument}"));
        }
    }
    faults
}

/// Functions that `src/ffi` exports, read from the source without cbindgen.
fn exported() -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    let entries = std::fs::read_dir(root().join("src/ffi")).unwrap().map(|e| e.unwrap().path());
    for file in entries.filter(|p| p.is_file()) {
        let text = std::fs::read_to_string(file).unwrap();
        for (at, _) in text.match_indices("#[unsafe(no_mangle)]") {
            let after = text[at..].split_once("extern \"C\" fn ").unwrap().1;
            names.insert(after.split('(').next().unwrap().to_string());
        }
    }
    names
}

/// A single value where the library writes many would have the host's memory overwritten.
#[test]
fn what_receives_many_is_an_array_in_labview() {
    let header = header();
    let mut looked_at = 0;
    for part in header.split("/**").skip(1) {
        let (comment, rest) = part.split_once("*/").unwrap();
        let Some(declaration) = declarations(rest).into_iter().next() else { continue };
        let comment = comment.replace("\n *", "");
        let arguments = declaration.trim_end_matches(";").trim_end_matches(')').split_once('(').unwrap().1;
        for parameter in arguments.split(',').map(str::trim).filter(|p| p.contains('*') && !p.contains("const")) {
            let name = parameter.rsplit([' ', '*']).next().unwrap();
            let Some((_, told)) = comment.split_once(&format!("`{name}`")) else { continue };
            let told = told.split(". ").next().unwrap();
            let many = ["width x height", "`count`", "capacity"].iter().any(|word| told.contains(word));
            let (kind, _) = terminal(&declaration, parameter);
            assert!(!many || !kind.starts_with("Numeric"), "{declaration}: {name} is {kind}");
            looked_at += usize::from(many);
        }
    }
    assert!(looked_at > 30, "{looked_at} arrays are told of");
}

#[test]
fn the_committed_headers_are_those_of_the_source() {
    let header = header();
    for (name, text) in [
        ("include/spivcal.h", header.clone()),
        ("include/spivcal_labview.h", labview(&header)),
        ("ffi_examples/labview.md", labview_recipe(&header)),
    ] {
        let path = root().join(name);
        if std::env::var_os("SPIVCAL_WRITE_HEADERS").is_some() {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, &text).unwrap();
        }
        let committed = std::fs::read_to_string(&path).unwrap_or_default();
        let first = committed.lines().zip(text.lines()).position(|(a, b)| a != b);
        assert!(
            committed == text,
            "{name} is not that of src/ffi (first difference: line {:?}); \
             run SPIVCAL_WRITE_HEADERS=1 cargo test --test c_header and commit it",
            first.map(|l| l + 1)
        );
    }
}

#[test]
fn every_exported_function_is_declared_with_allowed_types() {
    let all = declarations(&header());
    let name = |d: &String| d.split('(').next().unwrap().rsplit(' ').next().unwrap().to_string();
    assert_eq!(all.iter().map(name).collect::<BTreeSet<_>>(), exported());
    let faults: Vec<String> = all.iter().flat_map(|d| faults(d)).collect();
    assert!(faults.is_empty(), "{faults:#?}");
}

/// Each function's comment, name and parameters as the header has them.
fn documented(header: &str) -> Vec<(String, String, Vec<String>)> {
    let mut all = Vec::new();
    for (at, _) in header.match_indices("\nint32_t spivcal_") {
        let comment = header[..at].rsplit_once("/**").map_or("", |c| c.1);
        // A comment that belongs to something before is none of this function.
        let comment =
            if comment.trim_end().ends_with("*/") && comment.matches("*/").count() == 1 { comment } else { "" };
        let (head, rest) = header[at..].split_once('(').unwrap();
        let inside = rest.split_once(')').unwrap().0;
        let name = |p: &str| p.trim().rsplit([' ', '*']).next().unwrap().to_string();
        let parameters = inside.split(',').map(name).filter(|p| p != "void").collect();
        all.push((comment.to_string(), name(head), parameters));
    }
    all
}

/// Parameters that no comment explains: neither that of their function nor one that it refers to. The first parameter is the handle of the
/// object that the function is about.
fn unexplained(all: &[(String, String, Vec<String>)]) -> Vec<String> {
    let explains = |comment: &str, p: &str| comment.contains(&format!("`{p}`"));
    let mut faults = Vec::new();
    for (comment, name, parameters) in all {
        if comment.trim().len() < 12 {
            faults.push(format!("{name}: no comment"));
        }
        for p in parameters.iter().skip(1) {
            let referred = |other: &(String, String, Vec<String>)| {
                other.1 != *name && comment.contains(&other.1) && other.2.contains(p) && explains(&other.0, p)
            };
            if !explains(comment, p) && !all.iter().any(referred) {
                faults.push(format!("{name}: {p}"));
            }
        }
    }
    faults
}

#[test]
fn every_function_says_what_its_parameters_are() {
    let all = documented(&header());
    assert_eq!(all.iter().map(|f| f.1.clone()).collect::<BTreeSet<_>>(), exported());
    assert_eq!(unexplained(&all), Vec::<String>::new());
    let one = |comment: &str| {
        let head =
            format!("/**\n * {comment}\n */\nint32_t spivcal_a(uint64_t h,\n                  const double *x_mm);\n");
        unexplained(&documented(&head))
    };
    assert!(one("Does something. `x_mm`: a double.").is_empty());
    assert_eq!(one("Does something with x_mm."), ["spivcal_a: x_mm"]);
    assert_eq!(unexplained(&documented("\nint32_t spivcal_a(void);\n")), ["spivcal_a: no comment"]);
}

#[test]
fn constants_are_documented_and_no_number_means_two_things() {
    let header = header();
    let lines: Vec<&str> = header.lines().collect();
    let mut keys = std::collections::BTreeMap::new();
    let mut count = 0;
    for (i, line) in lines.iter().enumerate() {
        let Some(rest) = line.strip_prefix("#define SPIVCAL_") else { continue };
        let Some((name, value)) = rest.split_once(' ') else { continue };
        count += 1;
        assert!(lines[i - 1].trim() == "*/", "SPIVCAL_{name} has no comment");
        let value: i32 = value.trim().trim_matches(['(', ')']).parse().unwrap();
        // Keys of the functions that many things go through; small families start anew.
        if value >= 101 {
            assert_eq!(keys.insert(value, name), None, "{value}");
        }
    }
    assert!(count > 100, "{count} constants");
}

#[test]
fn keys_with_an_index_say_what_it_counts() {
    let header = header();
    let mut seen = 0;
    for (name, value) in constants(&header) {
        let counted = ["SPIVCAL_CAMERA_", "SPIVCAL_VIEW_"].iter().any(|f| name.starts_with(f));
        if !(counted || name == "SPIVCAL_TARGET_RADIUS_MM") {
            continue;
        }
        let before = header.split_once(&format!("#define {name} {value}")).unwrap().0;
        assert!(before.rsplit_once("/**").unwrap().1.contains("Index: "), "{name}");
        seen += 1;
    }
    assert_eq!(seen, 33);
}

fn constants(header: &str) -> std::collections::BTreeMap<&str, &str> {
    header.lines().filter_map(|l| l.strip_prefix("#define ")?.split_once(' ')).map(|(n, v)| (n, v.trim())).collect()
}

/// Numbers are compiled into programs: those of the first release stay. (Its functions are the business of `cpp_tests/interface`.)
#[test]
fn constants_of_the_first_release_keep_their_numbers() {
    let (frozen, today) = (include_str!("../cpp_tests/interface/frozen/spivcal.h"), header());
    let (frozen, today) = (constants(frozen), constants(&today));
    assert!(frozen.len() > 100, "{} constants", frozen.len());
    for (name, value) in frozen {
        assert_eq!(today.get(name), Some(&value), "{name}");
    }
}

#[test]
fn the_contract_names_functions_that_exist() {
    let exported = exported();
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    for name in CONTRACT.split(|c| !word(c)).filter(|w| w.starts_with("spivcal_") && !w.ends_with('_')) {
        assert!(exported.contains(name), "{name}");
    }
}

#[test]
fn the_checkers_refuse_what_they_must() {
    assert!(faults("int32_t spivcal_a(uint64_t h, const double *x, char *b)").is_empty());
    assert!(faults("int32_t spivcal_a(void)").is_empty());
    for bad in [
        "void spivcal_a(uint64_t h)",
        "int32_t other(uint64_t h)",
        "int32_t spivcal_a(bool h)",
        "int32_t spivcal_a(size_t h)",
        "int32_t spivcal_a(void *h)",
        "int32_t spivcal_a(char **h)",
        "int32_t spivcal_a(double h[9])",
        "int32_t spivcal_a(enum E e)",
    ] {
        assert_eq!(faults(bad).len(), 1, "{bad}");
    }
    // A type that C does not know makes cbindgen warn, and that is seen.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.rs");
    std::fs::write(&file, "#[no_mangle] pub extern \"C\" fn spivcal_bad(x: (f64, f64)) -> i32 { 0 }").unwrap();
    let (text, warnings) = generate(&[file]);
    assert!(!warnings.is_empty() && !text.contains("spivcal_bad("), "{text} {warnings:?}");
}
