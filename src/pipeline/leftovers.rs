//! Temporary files of a process that was ended before it could rename or remove them.

use std::fs;
use std::path::Path;
#[cfg(target_os = "linux")]
use std::time::Duration;

/// The process of a temporary name, `.NAME.PID.NUMBER.tmp` or `.old`; none of any other name.
fn process_of(name: &str) -> Option<u32> {
    let stem = name.strip_prefix('.')?;
    let stem = stem.strip_suffix(".tmp").or_else(|| stem.strip_suffix(".old"))?;
    let (stem, number) = stem.rsplit_once('.')?;
    let (own, process) = stem.rsplit_once('.')?;
    let plain = |text: &str| text.parse::<u32>().ok().filter(|n| n.to_string() == text);
    plain(number)?;
    plain(process).filter(|_| !own.is_empty())
}

/// Younger files stay: a folder that several machines share may hold those of a process that only another one shows.
#[cfg(target_os = "linux")]
const OLD: Duration = Duration::from_secs(600);

/// Removes from a folder what processes left there that are no more; what cannot be removed stays.
///
/// Only files of the own user, whose processes the system shows whatever else it hides, that have had their names for ten minutes; where it shows none,
/// nothing is removed.
#[cfg(target_os = "linux")]
pub(super) fn remove(folder: &Path) {
    remove_older(folder, OLD);
}

#[cfg(target_os = "linux")]
fn remove_older(folder: &Path, than: Duration) {
    use std::os::unix::fs::MetadataExt;
    let (Ok(own), Ok(entries)) = (fs::metadata("/proc/self"), fs::read_dir(folder)) else { return };
    for entry in entries.flatten() {
        let Some(process) = entry.file_name().to_str().and_then(process_of) else { continue };
        let gone = || fs::symlink_metadata(format!("/proc/{process}")).is_err();
        // Not that of a link, which may lead anywhere.
        // When it got its name (a link to an old result has the time of that otherwise), before this process was first looked at.
        let old = |m: &fs::Metadata| own.ctime().saturating_sub(m.ctime()).max(0) as u64 >= than.as_secs();
        let ours = entry.metadata().is_ok_and(|m| m.is_file() && m.uid() == own.uid() && old(&m));
        if ours && gone() {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Without a list of processes nobody knows which are no more.
#[cfg(not(target_os = "linux"))]
pub(super) fn remove(_: &Path) {}

#[cfg(test)]
mod tests {
    use super::*;

    /// No process: numbers of processes end far below.
    const NONE: u32 = u32::MAX;

    #[test]
    fn temporary_names_are_told_from_all_others() {
        assert_eq!(process_of(".report.html.123.0.tmp"), Some(123));
        assert_eq!(process_of(".a.b.77.12.old"), Some(77));
        for other in [
            "report.html.123.0.tmp",
            ".123.0.tmp",
            ".x.123.tmp",
            ".x.123.0.tmp2",
            ".x.0123.0.tmp",
            ".x.123.+1.tmp",
            ".x.-1.0.tmp",
            ".x.123.0.TMP",
            ".x.99999999999.0.tmp",
            ".tmp",
            "",
        ] {
            assert_eq!(process_of(other), None, "{other}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn files_of_processes_that_are_no_more_are_removed_and_no_others() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
        let own = std::process::id();
        let left = [format!(".x.txt.{NONE}.0.tmp"), format!(".x.txt.{NONE}.3.old")];
        let kept = [
            format!(".x.txt.{own}.0.tmp"),
            format!("x.txt.{NONE}.0.tmp"),
            format!(".x.txt.{NONE}.tmp"),
            "x.txt".to_string(),
        ];
        for name in left.iter().chain(&kept) {
            fs::write(folder.join(name), "1").unwrap();
        }
        // Too young to be nobody's.
        remove(folder);
        assert!(left.iter().all(|name| folder.join(name).exists()));
        fs::create_dir(folder.join(format!(".y.{NONE}.0.tmp"))).unwrap();
        remove_older(folder, Duration::ZERO);
        assert!(left.iter().all(|name| !folder.join(name).exists()));
        assert!(kept.iter().all(|name| folder.join(name).exists()));
        assert!(folder.join(format!(".y.{NONE}.0.tmp")).exists());
        remove(&folder.join("none"));
    }
}
