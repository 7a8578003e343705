//! Files read and written: all results of a command or none, each under a temporary name first.

use super::leftovers;
use crate::error::{Error, Invalid, Result};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Reads a text file; `what` it should be is said where it cannot be read.
pub fn read_text(path: &Path, what: &str) -> Result<String> {
    let bytes = fs::read(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => fault(path, format!("there is no such file; expected {what}")),
        _ if path.is_dir() => fault(path, format!("this is a folder; expected {what}")),
        _ => fault(path, format!("cannot be read: {}", of_the_system(&e))),
    })?;
    String::from_utf8(bytes).map_err(|_| fault(path, format!("this is not text in UTF-8; expected {what}")))
}

fn fault(path: &Path, message: impl Into<String>) -> Error {
    Invalid::File { path: path.display().to_string(), message: message.into() }.into()
}

/// What the system refused, in English: its own words are in the language of the process.
pub fn of_the_system(error: &std::io::Error) -> String {
    match error.raw_os_error() {
        Some(number) => format!("{} (error {number} of the system)", error.kind()),
        None => error.to_string(),
    }
}

/// Bytes of a name that stand in the temporary one: with numbers it is to have 255 at most.
const LONGEST_KEPT: usize = 200;
/// Links from one to the next at most; a ring of them leads nowhere.
const MOST_LINKS: usize = 40;
/// Results of more bytes than this do not wait in memory.
const MOST_HELD: usize = if cfg!(test) { 1000 } else { 256 << 20 };

/// Results on their way to a folder.
///
/// Nothing is seen under its name until [`Output::commit`]: every file is written under a temporary name beside its
/// place, and only then are they all renamed. An error or a crash before leaves the old files. What a process that was
/// ended left under temporary names the next that writes into the folder removes.
#[derive(Default)]
pub struct Output {
    names: Vec<String>,
    held: Vec<(String, Vec<u8>)>,
    staged: Option<Staged>,
}

impl Output {
    /// Adds a file; `name` is relative to the folder.
    pub fn add(&mut self, name: impl Into<String>, bytes: impl Into<Vec<u8>>) {
        let name = name.into();
        self.names.push(name.clone());
        self.held.push((name, bytes.into()));
    }
    /// One of a series that may be long: what memory should not hold waits in `folder` under temporary names.
    ///
    /// # Errors
    /// [`Invalid::File`] where a file cannot be written; nothing is left then.
    pub fn add_to_series(&mut self, folder: &Path, name: impl Into<String>, bytes: impl Into<Vec<u8>>) -> Result<()> {
        self.add(name, bytes);
        let held: usize = self.held.iter().map(|(_, b)| b.len()).sum();
        if held > MOST_HELD { self.stage(folder) } else { Ok(()) }
    }
    /// Names of the files added so far.
    pub fn names(&self) -> Vec<&str> {
        self.names.iter().map(String::as_str).collect()
    }
    /// [`Output::commit`], but never over one of the files that were read.
    ///
    /// # Errors
    /// [`Invalid::File`] as there, and where a file would take the place of one of the `inputs`; nothing is written then.
    pub fn commit_beside(self, folder: &Path, inputs: &[&Path]) -> Result<()> {
        spares(folder, &self.names(), inputs)?;
        self.commit(folder)
    }
    /// Writes all files into `folder`, which is made where it is missing.
    ///
    /// # Errors
    /// [`Invalid::File`] where a file cannot be written; what was there before is unchanged then.
    pub fn commit(mut self, folder: &Path) -> Result<()> {
        for (i, name) in self.names.iter().enumerate() {
            if self.names[..i].contains(name) {
                return Err(fault(&folder.join(name), "two results would be written to this one file"));
            }
        }
        self.stage(folder)?;
        self.staged.map_or(Ok(()), Staged::publish)
    }
    /// Writes what is held under temporary names; they vanish with `self` unless they are published.
    fn stage(&mut self, folder: &Path) -> Result<()> {
        let mut staged = match self.staged.take() {
            Some(staged) => staged,
            None => Staged::new(folder)?,
        };
        for (name, bytes) in self.held.drain(..) {
            staged.write(&name, &bytes)?;
        }
        self.staged = Some(staged);
        Ok(())
    }
}

/// That files of these names in a folder are none of those that are read.
///
/// # Errors
/// [`Invalid::File`] where one is.
pub fn spares(folder: &Path, names: &[&str], inputs: &[&Path]) -> Result<()> {
    let same = |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    for name in names {
        if let Some(input) = inputs.iter().find(|input| same(input, &folder.join(name))) {
            let what = "this file, which was read, would be overwritten; name another place with -o";
            return Err(fault(input, what));
        }
    }
    Ok(())
}

/// That results can be written into a folder, or into one made there: asked before the work, and nothing is left of it.
///
/// # Errors
/// [`Invalid::File`] where there is a file in its way, or nothing can be written.
pub fn can_write(folder: &Path) -> Result<()> {
    let there = folder.ancestors().find(|p| !p.as_os_str().is_empty() && p.exists()).unwrap_or(Path::new("."));
    if !there.is_dir() {
        let what = format!(
            "this folder for the results cannot be made: {} is a file; name another place with -o",
            there.display()
        );
        return Err(fault(folder, what));
    }
    let trial = Staged { folder: there.to_path_buf(), made: None, files: vec![], published: false };
    let written = trial.temporary(&there.join("trial")).and_then(|(_, path)| fs::remove_file(path));
    written.map_err(|e| {
        let why = of_the_system(&e);
        fault(folder, format!("nothing can be written in {}: {why}; name another place with -o", there.display()))
    })
}

/// Temporary files that vanish unless they are published.
struct Staged {
    folder: PathBuf,
    /// The outermost folder that was made for them.
    made: Option<PathBuf>,
    /// Those that wait for their place, and that place.
    files: Vec<(PathBuf, PathBuf)>,
    published: bool,
}

impl Staged {
    fn new(folder: &Path) -> Result<Self> {
        let made =
            folder.ancestors().filter(|p| !p.as_os_str().is_empty() && !p.exists()).last().map(Path::to_path_buf);
        let staged = Self { folder: folder.to_path_buf(), made, files: Vec::new(), published: false };
        fs::create_dir_all(folder)
            .map_err(|e| fault(folder, format!("this folder for the results cannot be made: {}", of_the_system(&e))))?;
        // Of a run that was ended while it wrote.
        leftovers::remove(folder);
        Ok(staged)
    }
    fn write(&mut self, name: &str, bytes: &[u8]) -> Result<()> {
        let place = followed(self.folder.join(name));
        if place.is_dir() {
            return Err(fault(&place, "there is a folder where a result must be written; remove or rename it"));
        }
        let old = fs::metadata(&place).ok();
        if old.as_ref().is_some_and(|old| !old.is_file()) {
            return Err(fault(
                &place,
                "there is a device or a pipe where a result must be written; name another place",
            ));
        }
        let written = self.temporary(&place).and_then(|(mut f, temporary)| {
            self.files.push((temporary, place.clone()));
            // Who may read the old result may read the new one, where the file system knows of that.
            let _ = old.map(|old| f.set_permissions(old.permissions()));
            f.write_all(bytes)?;
            // Without it a power failure could leave the new name with nothing in it.
            f.sync_all()
        });
        written.map_err(|e| fault(&place, format!("cannot be written: {}", of_the_system(&e))))
    }
    /// A new file beside its place: other threads and processes may be writing the same result.
    fn temporary(&self, place: &Path) -> std::io::Result<(fs::File, PathBuf)> {
        let mut number = 0u32;
        loop {
            let path = beside(place, number, "tmp");
            match fs::File::create_new(&path) {
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => number += 1,
                file => return Ok((file?, path)),
            }
        }
    }
    /// All or none: where one result cannot take its place, the others give theirs back.
    fn publish(mut self) -> Result<()> {
        let mut done: Vec<(PathBuf, Option<PathBuf>)> = vec![];
        // In their order. What has its place is forgotten: its temporary name may be another thread's by now.
        self.files.reverse();
        while let Some((temporary, place)) = self.files.last() {
            match spare(place).and_then(|old| renamed(temporary, place, old)) {
                Ok(old) => done.push((place.clone(), old)),
                Err(e) => {
                    done.iter().for_each(|(place, old)| restore(place, old.as_deref()));
                    return Err(fault(place, format!("cannot be written: {}", of_the_system(&e))));
                }
            }
            self.files.pop();
        }
        self.published = true;
        for old in done.into_iter().filter_map(|(_, old)| old) {
            let _ = fs::remove_file(old);
        }
        Ok(())
    }
}

/// Another name beside a place, of no more bytes than file systems give names.
fn beside(place: &Path, number: u32, ending: &str) -> PathBuf {
    let name = place.file_name().unwrap_or_default().to_string_lossy();
    let mut kept = name.len().min(LONGEST_KEPT);
    while !name.is_char_boundary(kept) {
        kept -= 1;
    }
    place.with_file_name(format!(".{}.{}.{number}.{ending}", &name[..kept], std::process::id()))
}

/// Where a link at a place leads, be it there or not.
fn followed(place: PathBuf) -> PathBuf {
    let linked = |at: &Path| Some(at.parent()?.join(fs::read_link(at).ok()?));
    let mut end = place.clone();
    for _ in 0..MOST_LINKS {
        match linked(&end) {
            Some(next) => end = next,
            None => return end,
        }
    }
    place
}

/// A second name for the file at `place`, if any, until all results are under their names.
fn spare(place: &Path) -> std::io::Result<Option<PathBuf>> {
    use std::io::ErrorKind::{AlreadyExists, NotFound};
    let mut number = 0u32;
    while place.is_file() {
        let old = beside(place, number, "old");
        // Some file systems give a file one name only.
        let copied = || {
            let (mut from, mut to) = (fs::File::open(place)?, fs::File::create_new(&old)?);
            std::io::copy(&mut from, &mut to).map(drop).inspect_err(|_| drop(fs::remove_file(&old)))
        };
        let linked = fs::hard_link(place, &old);
        match linked.or_else(|e| if matches!(e.kind(), AlreadyExists | NotFound) { Err(e) } else { copied() }) {
            Err(e) if e.kind() == AlreadyExists => number += 1,
            Err(e) if e.kind() == NotFound => break,
            kept => return kept.map(|()| Some(old)),
        }
    }
    Ok(None)
}

/// Puts a file in its place and hands back what was there before; drops that where it cannot.
fn renamed(temporary: &Path, place: &Path, old: Option<PathBuf>) -> std::io::Result<Option<PathBuf>> {
    if let Err(e) = fs::rename(temporary, place) {
        if let Some(old) = old {
            let _ = fs::remove_file(old);
        }
        return Err(e);
    }
    Ok(old)
}

/// What was at `place` before it was published.
fn restore(place: &Path, old: Option<&Path>) {
    let _ = match old {
        Some(old) => fs::rename(old, place),
        None => fs::remove_file(place),
    };
}

impl Drop for Staged {
    fn drop(&mut self) {
        if self.published {
            return;
        }
        for (temporary, _) in &self.files {
            let _ = fs::remove_file(temporary);
        }
        // Only folders made here, and only as far as they are empty.
        let Some(outermost) = &self.made else { return };
        for folder in self.folder.ancestors().take_while(|p| p.starts_with(outermost)) {
            let _ = fs::remove_dir(folder);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listing(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn all_files_appear_and_replace_old_ones() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("a/b");
        for content in ["old", "new"] {
            let mut out = Output::default();
            out.add("x.txt", content);
            out.add("y.bin", [0u8, 1]);
            assert_eq!(out.names(), ["x.txt", "y.bin"]);
            out.commit(&folder).unwrap();
            assert_eq!(listing(&folder), ["x.txt", "y.bin"]);
            assert_eq!(fs::read_to_string(folder.join("x.txt")).unwrap(), content);
        }
    }

    #[test]
    fn threads_that_write_one_file_leave_it_whole() {
        let scratch = tempfile::tempdir().unwrap();
        let (place, size) = (scratch.path().join("x.txt"), 300_000);
        fs::write(&place, vec![b'0'; size]).unwrap();
        let whole = |bytes: Vec<u8>| bytes.len() == size && bytes.iter().all(|b| *b == bytes[0]);
        std::thread::scope(|s| {
            let write = |letter: u8| {
                for _ in 0..20 {
                    let mut out = Output::default();
                    out.add("x.txt", vec![letter; size]);
                    out.commit(scratch.path()).unwrap();
                }
            };
            let writers: Vec<_> = (b'a'..b'e').map(|letter| s.spawn(move || write(letter))).collect();
            while !writers.iter().all(|w| w.is_finished()) {
                assert!(whole(fs::read(&place).unwrap()));
            }
            writers.into_iter().for_each(|w| w.join().unwrap());
        });
        assert_eq!(listing(scratch.path()), ["x.txt"]);
    }

    #[test]
    fn what_was_read_is_not_overwritten() {
        let scratch = tempfile::tempdir().unwrap();
        let input = scratch.path().join("calibration.json");
        fs::write(&input, "measured").unwrap();
        let output = || {
            let mut out = Output::default();
            out.add("check.json", "1");
            out.add("calibration.json", "2");
            out
        };
        let told = output().commit_beside(scratch.path(), &[&input]).unwrap_err().to_string();
        assert!(told.contains("would be overwritten") && told.contains("-o"), "{told}");
        assert_eq!(listing(scratch.path()), ["calibration.json"]);
        assert_eq!(fs::read_to_string(&input).unwrap(), "measured");
        output().commit_beside(&scratch.path().join("new"), &[&input]).unwrap();
        assert_eq!(listing(&scratch.path().join("new")), ["calibration.json", "check.json"]);
    }

    #[test]
    fn a_failure_leaves_the_old_files_and_nothing_else() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
        fs::write(folder.join("x.txt"), "old").unwrap();
        fs::create_dir(folder.join("y.txt")).unwrap();
        let mut out = Output::default();
        out.add("x.txt", "new");
        out.add("y.txt", "new");
        let message = out.commit(folder).unwrap_err().to_string();
        assert!(message.contains("y.txt"), "{message}");
        assert_eq!(listing(folder), ["x.txt", "y.txt"]);
        assert_eq!(fs::read_to_string(folder.join("x.txt")).unwrap(), "old");
    }

    #[test]
    fn a_failure_half_way_brings_the_old_files_back() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
        fs::write(folder.join("x.txt"), "old").unwrap();
        let mut staged = Staged::new(folder).unwrap();
        for name in ["x.txt", "y.txt", "z.txt"] {
            staged.write(name, b"new").unwrap();
        }
        fs::create_dir(folder.join("z.txt")).unwrap();
        assert!(staged.publish().unwrap_err().to_string().contains("z.txt"));
        assert_eq!(listing(folder), ["x.txt", "z.txt"]);
        assert_eq!(fs::read_to_string(folder.join("x.txt")).unwrap(), "old");
    }

    #[test]
    fn a_long_series_waits_under_temporary_names_and_leaves_nothing_where_it_fails() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("new");
        let series = || {
            let mut out = Output::default();
            for k in 0..5 {
                out.add_to_series(&folder, format!("{k}.tif"), vec![k; 400]).unwrap();
            }
            out
        };
        let out = series();
        let waiting = listing(&folder);
        assert!(waiting.len() == 3 && waiting.iter().all(|n| n.starts_with('.') && n.ends_with(".tmp")), "{waiting:?}");
        drop(out);
        assert!(!folder.exists());
        series().commit(&folder).unwrap();
        assert_eq!(listing(&folder), ["0.tif", "1.tif", "2.tif", "3.tif", "4.tif"]);
        assert_eq!(fs::read(folder.join("3.tif")).unwrap(), vec![3; 400]);
        let mut twice = series();
        twice.add("1.tif", "again");
        assert!(twice.commit(&folder).unwrap_err().to_string().contains("two results"));
        assert_eq!(listing(&folder).len(), 5);
    }

    #[test]
    fn two_results_of_one_name_are_refused() {
        let scratch = tempfile::tempdir().unwrap();
        let mut out = Output::default();
        out.add("x.txt", "1");
        out.add("x.txt", "2");
        let message = out.commit(&scratch.path().join("new")).unwrap_err().to_string();
        assert!(message.contains("x.txt") && message.contains("two results"), "{message}");
        assert_eq!(listing(scratch.path()), Vec::<String>::new());
    }

    #[test]
    fn a_folder_made_for_nothing_is_removed() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("a/b/c");
        let mut out = Output::default();
        out.add("missing/x.txt", "new");
        assert!(out.commit(&folder).is_err());
        assert_eq!(listing(scratch.path()), Vec::<String>::new());
    }

    #[test]
    fn what_cannot_be_written_is_known_before_the_work() {
        let scratch = tempfile::tempdir().unwrap();
        let file = scratch.path().join("file");
        fs::write(&file, "mine").unwrap();
        for place in [file.clone(), file.join("below")] {
            let told = can_write(&place).unwrap_err().to_string();
            assert!(told.contains("cannot be made") && told.contains("-o"), "{told}");
        }
        for place in ["", "new", "new/below"].map(|name| scratch.path().join(name)) {
            assert_eq!(can_write(&place), Ok(()));
        }
        assert_eq!(listing(scratch.path()), ["file"]);
    }

    #[test]
    fn a_file_in_the_place_of_the_folder_is_refused() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("file");
        fs::write(&folder, "mine").unwrap();
        let message = Output::default().commit(&folder).unwrap_err().to_string();
        assert!(message.contains("cannot be made"), "{message}");
        assert_eq!(fs::read_to_string(&folder).unwrap(), "mine");
    }

    #[test]
    fn text_that_cannot_be_read_says_what_was_expected() {
        let scratch = tempfile::tempdir().unwrap();
        let message = |p: &Path| read_text(p, "a rig file").unwrap_err().to_string();
        assert!(message(&scratch.path().join("none")).contains("no such file; expected a rig file"));
        assert!(message(scratch.path()).contains("folder"));
        let binary = scratch.path().join("b");
        fs::write(&binary, [0xff, 0xfe, 0x00]).unwrap();
        assert!(message(&binary).contains("UTF-8"));
    }
}
