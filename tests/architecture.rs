//! The map of the rooms is true: arrows only point down, and what only one place may do is done only there.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Level of each room and its row on the map, as `src/MAP.md` says.
type Rooms = BTreeMap<String, (u8, usize)>;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn rooms(map: &str) -> Rooms {
    let mut rooms = Rooms::new();
    for (row, line) in map.lines().filter(|l| l.starts_with("| L")).enumerate() {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let level = cells[1].trim_start_matches('L').parse().unwrap();
        let name = cells[2].trim_matches('`').to_string();
        assert!(!cells[3].is_empty(), "{name} has no job");
        assert!(rooms.insert(name.clone(), (level, row)).is_none(), "{name} is listed twice");
    }
    rooms
}

/// A source file without comments, strings and its `mod tests`, with line breaks kept.
///
/// Comments and strings may say anything; tests may look up (they check a room against a higher one).
fn code(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        if let Some(tail) = rest.strip_prefix("//") {
            rest = tail.find('\n').map_or("", |end| &tail[end..]);
        } else if let Some(tail) = raw_string(rest).or_else(|| string(rest)).or_else(|| character(rest)) {
            out.push_str("\"\"");
            out.extend(rest[..rest.len() - tail.len()].chars().filter(|c| *c == '\n'));
            rest = tail;
        } else {
            out.push(c);
            rest = &rest[c.len_utf8()..];
        }
    }
    match out.find("#[cfg(test)]\nmod tests {") {
        Some(start) => out[..start].to_string(),
        None => out,
    }
}

fn raw_string(text: &str) -> Option<&str> {
    let tail = text.strip_prefix('r')?;
    let hashes = tail.len() - tail.trim_start_matches('#').len();
    let tail = tail[hashes..].strip_prefix('"')?;
    let end = format!("\"{}", "#".repeat(hashes));
    tail.find(&end).map(|i| &tail[i + end.len()..])
}

fn string(text: &str) -> Option<&str> {
    let tail = text.strip_prefix('"')?;
    let mut escaped = false;
    for (i, c) in tail.char_indices() {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return Some(&tail[i + 1..]),
            _ => {}
        }
    }
    None
}

/// `'x'` and `'\n'`, not the lifetime `'a`.
fn character(text: &str) -> Option<&str> {
    let tail = text.strip_prefix('\'')?;
    let mut chars = tail.char_indices();
    let (_, first) = chars.next()?;
    if first == '\\' {
        return tail[2..].find('\'').map(|i| &tail[2 + i + 1..]);
    }
    let (i, second) = chars.next()?;
    (second == '\'').then(|| &tail[i + 1..])
}

/// Rooms named by `crate::` paths, also inside braces (`crate::{a::B, c}`), with the line.
fn named_rooms(code: &str) -> Vec<(usize, String)> {
    let mut named = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let before = code[..at].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_') {
            continue;
        }
        let line = code[..at].matches('\n').count() + 1;
        let tail = &code[at + "crate::".len()..];
        let heads: Vec<String> = match tail.strip_prefix('{') {
            Some(group) => group_heads(group),
            None => vec![identifier(tail)],
        };
        named.extend(heads.into_iter().map(|h| (line, h)));
    }
    named
}

fn identifier(text: &str) -> String {
    text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
}

fn group_heads(group: &str) -> Vec<String> {
    let (mut depth, mut heads, mut start) = (0, Vec::new(), 0);
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                heads.push(identifier(&group[start..i]));
                start = i + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    heads.retain(|h| !h.is_empty());
    heads
}

/// The re-exports of lib.rs (`crate::Error`, `crate::Result`) and macros are no rooms.
fn is_room_name(name: &str) -> bool {
    name.chars().next().is_some_and(char::is_lowercase)
}

/// What in `code` of `room` points up, sideways or to a room that is not on the map.
fn forbidden_arrows(rooms: &Rooms, room: &str, code: &str) -> Vec<String> {
    let mut faults = Vec::new();
    let Some(own) = rooms.get(room) else { return vec![format!("room {room} is not in src/MAP.md")] };
    for (line, other) in named_rooms(code) {
        if other == room || !is_room_name(&other) {
            continue;
        }
        match rooms.get(&other) {
            None => faults.push(format!("line {line}: {room} names {other}, which is not in src/MAP.md")),
            Some((level, row)) => {
                // On the ground floor the order of the rows decides.
                let below = *level < own.0 || (own.0 == 0 && *level == 0 && *row < own.1);
                if !below {
                    let levels = format!("{room} (L{}) names {other} (L{level})", own.0);
                    faults.push(format!("line {line}: {levels}, which is not below it"));
                }
            }
        }
    }
    faults
}

/// What code below L7 must not hold.
fn forbidden_words(level: u8, code: &str) -> Vec<String> {
    let io =
        ["std::fs", "std::io", "std::process", "std::env", "std::net", "println!", "print!", "eprintln!", "eprint!"];
    let everywhere = ["static mut", "SystemTime", "Instant::now", "thread_rng", "thread_local!", "lazy_static!"];
    let mut words: Vec<&str> = everywhere.to_vec();
    if level < 7 {
        words.extend(io);
    }
    words.iter().filter(|w| contains_word(code, w)).map(|w| w.to_string()).collect()
}

fn contains_word(code: &str, word: &str) -> bool {
    code.match_indices(word).any(|(at, _)| {
        let before = code[..at].chars().next_back();
        let after = code[at + word.len()..].chars().next();
        let joins = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
        !joins(before) && (word.ends_with('!') || !joins(after))
    })
}

/// Names, first line and number of lines of all functions.
fn functions(code: &str) -> Vec<(String, usize, usize)> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices("fn ") {
        if code[..at].chars().next_back().is_some_and(|c| c.is_alphanumeric() || c == '_') {
            continue;
        }
        let name = identifier(&code[at + 3..]);
        let mut depth = 0;
        for (i, c) in code[at..].char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth > 0 => {
                    depth -= 1;
                    if depth == 0 {
                        let line = code[..at].matches('\n').count() + 1;
                        found.push((name, line, code[at..at + i].matches('\n').count() + 1));
                        break;
                    }
                }
                ';' if depth == 0 => break,
                _ => {}
            }
        }
    }
    found
}

/// All source files with their rooms; `lib.rs` and `main.rs` belong to none.
fn sources() -> Vec<(String, PathBuf, String)> {
    let src = root().join("src");
    let mut pending = vec![src.clone()];
    let mut files = Vec::new();
    while let Some(folder) = pending.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                pending.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let inside = path.strip_prefix(&src).unwrap();
                let room = inside.components().next().unwrap().as_os_str().to_string_lossy().replace(".rs", "");
                let text = std::fs::read_to_string(&path).unwrap();
                files.push((room, inside.to_path_buf(), text));
            }
        }
    }
    files.sort();
    files.retain(|(room, ..)| room != "lib" && room != "main");
    assert!(files.len() > 20, "the source files were not found");
    files
}

/// Files that only hold tests (`tests.rs`, `.../tests/...`) may look up.
fn is_test_file(path: &Path) -> bool {
    path.components().any(|c| matches!(c.as_os_str().to_str(), Some("tests.rs" | "tests")))
}

fn map() -> Rooms {
    rooms(&std::fs::read_to_string(root().join("src/MAP.md")).unwrap())
}

#[test]
fn arrows_only_point_down() {
    let rooms = map();
    let mut faults = Vec::new();
    for (room, path, text) in sources().iter().filter(|(_, p, _)| !is_test_file(p)) {
        let arrows = forbidden_arrows(&rooms, room, &code(text));
        faults.extend(arrows.into_iter().map(|f| format!("src/{}: {f}", path.display())));
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn every_room_on_the_map_exists() {
    let lib = std::fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let module =
        |l: &str| l.trim_start_matches("pub(crate) ").trim_start_matches("pub ").strip_prefix("mod ").map(String::from);
    let declared: Vec<String> = lib.lines().filter_map(module).map(|m| m.trim_end_matches(';').into()).collect();
    let listed: Vec<String> = map().into_keys().collect();
    let mut sorted = declared.clone();
    sorted.sort();
    assert_eq!(sorted, listed, "src/lib.rs and src/MAP.md do not name the same rooms");
}

#[test]
fn no_files_terminal_clock_or_globals_below_the_shell() {
    let rooms = map();
    let mut faults = Vec::new();
    for (room, path, text) in sources().iter().filter(|(_, p, _)| !is_test_file(p)) {
        for word in forbidden_words(rooms.get(room).map_or(0, |r| r.0), &code(text)) {
            faults.push(format!("src/{}: {word}", path.display()));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn what_one_place_may_do_is_done_only_there() {
    let mut with_faer = Vec::new();
    for (room, path, text) in sources() {
        let (code, path) = (code(&text), path.to_string_lossy().replace('\\', "/"));
        if contains_word(&code, "faer") {
            with_faer.push(path.clone());
        }
        if room != "ffi" && room != "lanes" {
            assert!(!contains_word(&code, "unsafe"), "src/{path}: unsafe belongs into ffi or lanes");
        }
    }
    assert_eq!(with_faer, ["solve/factor.rs"], "faer is known to one file");
    let both = rooms_with_both(&["camera", "solve"]);
    assert_eq!(both, ["bundle"], "only bundle lets a camera meet a solver");
}

/// Rooms that name all of `others`.
fn rooms_with_both(others: &[&str]) -> Vec<String> {
    let mut seen: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (room, path, text) in sources() {
        if !is_test_file(&path) {
            seen.entry(room).or_default().extend(named_rooms(&code(&text)).into_iter().map(|(_, r)| r));
        }
    }
    seen.into_iter().filter(|(_, r)| others.iter().all(|o| r.iter().any(|x| x == o))).map(|(room, _)| room).collect()
}

#[test]
fn files_and_functions_fit_their_reader() {
    let mut faults = Vec::new();
    for (_, path, text) in sources().iter().filter(|(_, p, _)| !is_test_file(p)) {
        let lines = text.lines().count();
        if lines >= 600 {
            faults.push(format!("src/{}: {lines} lines, at most 600", path.display()));
        }
        for (name, line, length) in functions(&code(text)) {
            if length > 80 {
                faults.push(format!("src/{}:{line}: {name} has {length} lines, at most 80", path.display()));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_checker_refuses_what_it_must() {
    let rooms = rooms(
        "| L0 | `error` | a |\n| L0 | `frames` | a |\n| L1 | `camera` | b |\n| L1 | `solve` | c |\n| L3 | `bundle` | d |\n",
    );
    let faults = |room: &str, text: &str| forbidden_arrows(&rooms, room, &code(text)).len();
    assert_eq!(faults("bundle", "use crate::camera::Camera; use crate::solve::step; use crate::{Error, Result};"), 0);
    assert_eq!(faults("camera", "use crate::error::{Error, Result};\nuse crate::camera::radial;"), 0);
    assert_eq!(faults("camera", "use crate::bundle::Model;"), 1, "upward");
    assert_eq!(faults("camera", "use crate::solve::step;"), 1, "a peer");
    assert_eq!(faults("frames", "use crate::error::Result;"), 0, "on the ground floor, listed above");
    assert_eq!(faults("error", "use crate::frames::Cam;"), 1, "on the ground floor, listed below");
    assert_eq!(faults("bundle", "use crate::common::thing;"), 1, "not on the map");
    assert_eq!(faults("attic", "use crate::error::Error;"), 1, "a room that is not on the map");
    assert_eq!(faults("camera", "fn f() -> crate::bundle::Model { todo() }"), 1, "a path without use");
    assert_eq!(faults("camera", "use crate::{error::Error, bundle::{Model, a::B}, solve};"), 2, "in braces");
    assert_eq!(faults("camera", "// crate::bundle\n/// [`crate::bundle`]\nlet s = \"crate::bundle\";"), 0, "words");
    assert_eq!(faults("camera", "#[cfg(test)]\nmod tests {\n use crate::bundle::Model;\n}"), 0, "tests may look up");
    assert_eq!(faults("camera", "let c = '\"'; use crate::bundle::M; let d = '\"';"), 1, "quotes as characters");
    assert_eq!(faults("camera", "let r = r#\"a \" b\"#; use crate::bundle::M;"), 1, "after a raw string");

    assert_eq!(forbidden_words(2, "fn f() { std::fs::read(p); println!(); }"), ["std::fs", "println!"]);
    assert!(forbidden_words(7, "std::fs::read(p)").is_empty());
    assert_eq!(forbidden_words(8, "static mut X: u8 = 0;"), ["static mut"]);
    assert!(forbidden_words(0, &code("// println! and std::fs")).is_empty());
    assert!(contains_word("unsafe { }", "unsafe") && !contains_word("deny(unsafe_code)", "unsafe"));

    let long = format!("fn a() {{\n{}}}\nfn b() {{ }}\ntrait T {{ fn c(); }}", "x;\n".repeat(90));
    let found = functions(&code(&long));
    assert_eq!(found.len(), 2);
    assert_eq!((found[0].0.as_str(), found[0].1, found[0].2), ("a", 1, 92));
}
