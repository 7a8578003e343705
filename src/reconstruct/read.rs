//! Planar displacement fields as text: CSV, and the exports of OpenPIV and PIVlab, told apart by their headers.
//!
//! | format | header | positions | y | left out |
//! |---|---|---|---|---|
//! | CSV | `x_px,y_px,dx_px,dy_px` or `x_mm,y_mm,dx_mm,dy_mm`; further columns are ignored, but `flag` and `sigma_dx_mm,sigma_dy_mm` (`_px`) | as named | down in px, up in mm | `flag` other than 0, empty cells, `nan` |
//! | OpenPIV | `# x y u v flags mask` (`flags` or `mask` may be missing) | px; mm where the user says so | up: rows were turned over by `transform_coordinates` | flagged or masked |
//! | PIVlab | `PIVlab ...`, `FRAME: ...`, `x [px],y [px],u [px/frame],v [px/frame],Vector type [-]` | px | down | vector type other than 1 |
//!
//! **Middles of windows.** The window of the pixels 0 to n - 1 has its middle at (n - 1) / 2. PIVlab counts pixels from 1 and calls the middle of that
//! window 1 + n / 2: 1.5 px are taken off. OpenPIV calls it n / 2 (`get_coordinates`; (n - 1) / 2 in older releases, which for windows of even sides shows
//! in positions of half pixels): 0.5 px are taken off whole positions in px. Both shift by whole pixels at most besides.
//!
//! A CSV with `x,y,u,v` (or `dx,dy`) leaves the unit open; the user says it. Columns are separated by commas, semicolons (then a
//! decimal comma is understood), tabs or blanks.

use crate::error::{Error, Invalid, Result};

/// Who wrote a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldFormat {
    /// Columns with names.
    Csv,
    /// `openpiv.tools.save`.
    OpenPiv,
    /// PIVlab, "export as ASCII".
    PivLab,
}

impl FieldFormat {
    /// Its name.
    pub fn word(self) -> &'static str {
        match self {
            FieldFormat::Csv => "CSV",
            FieldFormat::OpenPiv => "OpenPIV",
            FieldFormat::PivLab => "PIVlab",
        }
    }
}

/// What positions and displacements are measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldUnit {
    /// Pixels of the raw images; (0, 0) is the centre of the first pixel, y down.
    RawPixels,
    /// mm of the sheet frame (dewarped images with their scale), y up.
    Millimetres,
    /// Pixels of dewarped images; (0, 0) is the centre of the first pixel, y down.
    DewarpedPixels,
}

/// A field as it was read: one entry per row that is not left out.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldTable {
    /// File in messages.
    pub file: String,
    /// Who wrote it.
    pub format: FieldFormat,
    /// Unit, where the file names it.
    pub unit: Option<FieldUnit>,
    /// Positions: x to the right.
    pub x: Vec<f64>,
    /// Positions: y, down or up as the unit says.
    pub y: Vec<f64>,
    /// Displacement along x; `NaN` where missing.
    pub dx: Vec<f64>,
    /// Displacement along y, in the sense of y; `NaN` where missing.
    pub dy: Vec<f64>,
    /// Standard deviations of dx and dy, where the file has them; a vector without them is missing.
    pub sigma: Option<[Vec<f64>; 2]>,
}

/// Which column holds what.
struct Columns {
    /// How many the header names.
    count: usize,
    at: [usize; 4],
    sigma: Option<[usize; 2]>,
    /// Columns that must hold this value for the vector to count.
    wanted: Vec<(usize, f64)>,
}

fn fault(file: &str, line: usize, message: impl Into<String>) -> Error {
    Invalid::Syntax { file: file.into(), line, message: message.into() }.into()
}

/// What a message shows of a file: the beginning, nothing that a terminal would obey.
fn shown(text: &str) -> String {
    const MOST: usize = 60;
    let begin: String = text.chars().take(MOST).flat_map(char::escape_debug).collect();
    if text.chars().nth(MOST).is_some() { format!("{begin}...") } else { begin }
}

/// Cells of a line.
fn cells(line: &str, separator: char) -> Vec<String> {
    let parts: Vec<&str> = if separator == ' ' {
        line.split_whitespace().collect()
    } else {
        line.split(separator).map(str::trim).collect()
    };
    parts.into_iter().map(|p| if separator == ';' { p.replace(',', ".") } else { p.into() }).collect()
}

fn separator_of(line: &str) -> char {
    [';', '\t', ','].into_iter().find(|c| line.contains(*c)).unwrap_or(' ')
}

/// Reads a field; `file` is only named in messages.
///
/// ```
/// use spivcal::reconstruct::{FieldFormat, FieldUnit, parse_field};
/// let field = parse_field("x_px,y_px,dx_px,dy_px\n16,16,3.5,-0.2\n32,16,nan,nan\n", "left.csv")?;
/// assert_eq!((field.format, field.unit, field.x.len()), (FieldFormat::Csv, Some(FieldUnit::RawPixels), 2));
/// assert!(field.dx[1].is_nan());
/// # Ok::<(), spivcal::Error>(())
/// ```
///
/// # Errors
/// [`Invalid::Syntax`] with file and line where the text is no displacement field, a cell is no number, or a row has fewer or more cells than
/// the header names.
pub fn parse_field(text: &str, file: &str) -> Result<FieldTable> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    // Old programs end lines with a carriage return alone.
    let returns = if text.contains('\n') { None } else { Some(text.replace('\r', "\n")) };
    let text = returns.as_deref().unwrap_or(text);
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty()).peekable();
    let expected =
        "expected a header x_px,y_px,dx_px,dy_px or x_mm,y_mm,dx_mm,dy_mm, or an export of OpenPIV or PIVlab";
    let Some((first, head)) = lines.peek().copied() else {
        return Err(fault(file, 1, format!("the file is empty; {expected}")));
    };
    // With its lines about the file, or without them.
    let bare = head.trim_start_matches(['#', ' ', '"']);
    let pivlab = bare.starts_with("PIVlab") || bare.starts_with("x [");
    if pivlab {
        while lines.peek().is_some_and(|(_, l)| !l.trim_matches('"').starts_with("x [")) {
            lines.next();
        }
    }
    let Some((line, head)) = lines.next() else {
        return Err(fault(
            file,
            first,
            "this PIVlab export has no line with the names of the columns (x [px],y [px],...); export again",
        ));
    };
    let separator = separator_of(head);
    let head_cells = match (pivlab, separator) {
        // Names hold blanks themselves: each ends with its unit.
        (true, ' ') => head.split_inclusive(']').map(|n| n.trim().to_string()).filter(|n| !n.is_empty()).collect(),
        _ => cells(head.trim_start_matches(['#', ' ']), separator),
    };
    let names: Vec<String> = head_cells.iter().map(|n| n.trim_matches('"').trim().to_lowercase()).collect();
    let (format, unit, columns) = header(&names, head.starts_with('#'), pivlab, file, line, expected)?;
    let mut table =
        FieldTable { file: file.into(), format, unit, x: vec![], y: vec![], dx: vec![], dy: vec![], sigma: None };
    table.sigma = columns.sigma.map(|_| [vec![], vec![]]);
    // OpenPIV writes tabs below a header with blanks or tabs.
    let mut rows = lines.filter(|(_, l)| !l.starts_with('#')).peekable();
    let separator = rows.peek().map_or(separator, |(_, l)| separator_of(l));
    for (line, row) in rows {
        table.push(&cells(row, separator), &columns, line)?;
    }
    if table.x.is_empty() {
        return Err(fault(file, line, "there is a header but no vector below it; export the field again"));
    }
    table.turn_to_our_convention();
    Ok(table)
}

fn header(
    names: &[String],
    commented: bool,
    pivlab: bool,
    file: &str,
    line: usize,
    expected: &str,
) -> Result<(FieldFormat, Option<FieldUnit>, Columns)> {
    let find = |name: &str| names.iter().position(|n| n == name);
    let count = names.len();
    let four = |four: [&str; 4]| -> Option<[usize; 4]> {
        let at = four.map(find);
        at.iter().all(Option::is_some).then(|| at.map(Option::unwrap_or_default))
    };
    if pivlab {
        let at = four(["x [px]", "y [px]", "u [px/frame]", "v [px/frame]"]).ok_or_else(|| {
            let seen = shown(&names.join(", "));
            fault(
                file,
                line,
                format!("columns {seen}: expected px and px/frame; export from PIVlab without its calibration applied"),
            )
        })?;
        let wanted = find("vector type [-]").map(|c| (c, 1.0)).into_iter().collect();
        return Ok((FieldFormat::PivLab, Some(FieldUnit::RawPixels), Columns { count, at, sigma: None, wanted }));
    }
    let bad = ["flag", "flags", "mask"].iter().filter_map(|n| find(n)).map(|c| (c, 0.0)).collect();
    if let (true, Some(at)) = (commented, four(["x", "y", "u", "v"])) {
        return Ok((FieldFormat::OpenPiv, Some(FieldUnit::RawPixels), Columns { count, at, sigma: None, wanted: bad }));
    }
    let known = [
        (["x_px", "y_px", "dx_px", "dy_px"], Some(FieldUnit::RawPixels)),
        (["x_mm", "y_mm", "dx_mm", "dy_mm"], Some(FieldUnit::Millimetres)),
        (["x", "y", "u", "v"], None),
        (["x", "y", "dx", "dy"], None),
    ];
    for (columns, unit) in known {
        if let Some(at) = four(columns) {
            // Named after the displacement, with its unit.
            let sigma = sigma_columns(names, [columns[2], columns[3]]).map_err(|what| fault(file, line, what))?;
            return Ok((FieldFormat::Csv, unit, Columns { count, at, sigma, wanted: bad }));
        }
    }
    Err(fault(file, line, format!("columns \"{}\": {expected}", shown(&names.join(", ")))))
}

/// Columns of the standard deviations of two displacements; none is left unread.
fn sigma_columns(names: &[String], displacements: [&str; 2]) -> std::result::Result<Option<[usize; 2]>, String> {
    let wanted = displacements.map(|d| format!("sigma_{d}"));
    let known = |name: &&String| {
        let rest = name.strip_prefix("sigma_").map(|r| r.trim_end_matches("_px").trim_end_matches("_mm"));
        matches!(rest, Some("dx" | "dy" | "u" | "v"))
    };
    if let Some(other) = names.iter().filter(known).find(|n| !wanted.contains(n)) {
        let message = format!(
            "column {other}: the displacements are {}, so it would not be used; expected",
            displacements.join(", ")
        );
        return Err(format!("{message} {}", wanted.join(", ")));
    }
    match wanted.each_ref().map(|w| names.iter().position(|n| n == w)) {
        [Some(x), Some(y)] => Ok(Some([x, y])),
        [None, None] => Ok(None),
        [found, _] => {
            let (there, missing) = if found.is_some() { (0, 1) } else { (1, 0) };
            Err(format!("column {} without {}: give both, or neither", wanted[there], wanted[missing]))
        }
    }
}

impl FieldTable {
    fn push(&mut self, row: &[String], columns: &Columns, line: usize) -> Result<()> {
        let file = self.file.clone();
        let filled = row.iter().rposition(|c| !c.is_empty()).map_or(0, |last| last + 1);
        if filled > columns.count {
            let what = format!(
                "{filled} cells, but the header names {}; are decimals written with commas? Export with points, or with semicolons \
                 between the cells; or name every column in the header",
                columns.count
            );
            return Err(fault(&file, line, what));
        }
        let number = |column: usize| -> Result<f64> {
            let Some(cell) = row.get(column) else {
                let what = format!(
                    "{} columns, but the header names more: the row is cut short; export the field again",
                    row.len()
                );
                return Err(fault(&file, line, what));
            };
            match cell.trim_matches('"').to_lowercase().as_str() {
                "" | "nan" | "-nan" | "na" | "--" => Ok(f64::NAN),
                "true" => Ok(1.0),
                "false" => Ok(0.0),
                word => word.parse().map_err(|_| fault(&file, line, format!("\"{}\" is not a number", shown(cell)))),
            }
        };
        let [x, y, dx, dy] = columns.at.map(&number);
        let (x, y, mut dx, mut dy) = (x?, y?, dx?, dy?);
        if !(x.is_finite() && y.is_finite()) {
            return Err(fault(&self.file, line, "a vector without a position; every row needs x and y"));
        }
        for (column, wanted) in &columns.wanted {
            if number(*column)? != *wanted {
                (dx, dy) = (f64::NAN, f64::NAN);
            }
        }
        if let (Some(to), Some(at)) = (&mut self.sigma, columns.sigma) {
            for (to, at) in to.iter_mut().zip(at) {
                let sigma = number(at)?;
                if sigma <= 0.0 {
                    let what = format!("a standard deviation of {sigma}: expected a positive number, or an empty cell");
                    return Err(fault(&file, line, what));
                }
                if !sigma.is_finite() {
                    (dx, dy) = (f64::NAN, f64::NAN);
                }
                to.push(sigma);
            }
        }
        if !(dx.is_finite() && dy.is_finite()) {
            (dx, dy) = (f64::NAN, f64::NAN);
        }
        self.x.push(x);
        self.y.push(y);
        self.dx.push(dx);
        self.dy.push(dy);
        Ok(())
    }

    /// The field where the user says its unit: what OpenPIV wrote in mm has y up, as the sheet.
    ///
    /// ```
    /// use spivcal::reconstruct::{FieldUnit, parse_field};
    /// let field = parse_field("# x y u v\n-1 2 0.1 0.2\n-1 4 0.1 0.3\n", "left.txt")?.in_unit(FieldUnit::Millimetres);
    /// assert_eq!((field.y, field.dy), (vec![2.0, 4.0], vec![0.2, 0.3]));
    /// # Ok::<(), spivcal::Error>(())
    /// ```
    #[must_use]
    pub fn in_unit(mut self, unit: FieldUnit) -> Self {
        let up = |unit: Option<FieldUnit>| unit == Some(FieldUnit::Millimetres);
        if self.format == FieldFormat::OpenPiv {
            if up(Some(unit)) != up(self.unit) {
                self.turn_over();
            }
            if !up(Some(unit)) && self.is_whole() {
                self.shift(-0.5);
            }
        }
        self.unit = Some(unit);
        self
    }

    /// Pixels from the centre of the first pixel, y down.
    fn turn_to_our_convention(&mut self) {
        match self.format {
            FieldFormat::Csv => {}
            FieldFormat::PivLab => self.shift(-1.5),
            FieldFormat::OpenPiv => self.turn_over(),
        }
    }

    fn shift(&mut self, by: f64) {
        self.x.iter_mut().chain(&mut self.y).for_each(|p| *p += by);
    }

    /// Positions at whole pixels: of windows of an even side they are half a pixel beyond the middle.
    fn is_whole(&self) -> bool {
        self.x.iter().chain(&self.y).all(|p| (p - p.round()).abs() < 1e-3)
    }

    /// Turns the y axis over, about the middle of the field.
    fn turn_over(&mut self) {
        let low = self.y.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.y.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.y.iter_mut().for_each(|y| *y = low + high - *y);
        self.dy.iter_mut().for_each(|d| *d = -*d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        parse_field(text, "f.txt").unwrap_err().to_string()
    }

    #[test]
    fn openpiv_and_pivlab_come_to_one_convention() {
        let ours = parse_field(
            "x_px,y_px,dx_px,dy_px,flag\n15.5,15.5,1.5,0.5,0\n31.5,15.5,1.6,0.4,1\n15.5,31.5,1.7,0.3,0\n31.5,31.5,1.8,0.2,0\n",
            "a",
        )
        .unwrap();
        // Windows of 32 px: their middles as OpenPIV names them, and as it did before.
        let openpiv = "# x\ty\tu\tv\tflags\tmask\n1.6000e+01\t3.2000e+01\t1.5000e+00\t-5.0000e-01\t0.0000e+00\t0.0000e+00\n\
                       32.0\t32.0\t1.6\t-0.4\t1\t0\n16.0\t16.0\t1.7\t-0.3\t0\t0\n32.0\t16.0\t1.8\t-0.2\t0\t0\n";
        let older = "# x y u v flags mask\n15.5 31.5 1.5 -0.5 0 0\n31.5 31.5 1.6 -0.4 1 0\n15.5 15.5 1.7 -0.3 0 0\n31.5 15.5 1.8 -0.2 0 0\n";
        let pivlab = "PIVlab by W.Th. & E.J.S., ASCII chart output - 09-Jun-2015 14:02:30\n\
                      FRAME: 1, filenames: A.tif & B.tif, conversion factor xy (px -> m): 1, conversion factor uv (px/frame -> m/s): 1\n\
                      x [px],y [px],u [px/frame],v [px/frame],Vector type [-]\n17,17,1.5,0.5,1\n33,17,1.6,0.4,2\n17,33,1.7,0.3,1\n33,33,1.8,0.2,1\n";
        // Options of PIVlab's export: without the lines about the file, with blanks or tabs between the cells.
        let table = pivlab.split_once("\nx [").map(|(_, rest)| format!("x [{rest}")).unwrap();
        let (blanks, tabs) = (table.replace(',', " "), pivlab.replace(',', "\t"));
        let texts = [openpiv, older, pivlab, &table, &blanks, &tabs];
        let formats = [FieldFormat::OpenPiv; 2].into_iter().chain([FieldFormat::PivLab; 4]);
        for (text, format) in texts.into_iter().zip(formats) {
            let f = parse_field(text, "a").unwrap().in_unit(FieldUnit::RawPixels);
            assert_eq!((f.format, &f.x, &f.y), (format, &ours.x, &ours.y));
            for i in 0..4 {
                assert!(f.dx[i] == ours.dx[i] || i == 1 && f.dx[i].is_nan() && ours.dx[i].is_nan(), "{format:?}");
                assert!(f.dy[i] == ours.dy[i] || i == 1 && f.dy[i].is_nan() && ours.dy[i].is_nan(), "{format:?}");
            }
        }
    }

    /// A line of words between header and numbers has separators of its own.
    #[test]
    fn comments_below_the_header_say_nothing_of_the_columns() {
        let text = "x_mm,y_mm,dx_mm,dy_mm\n# made by foo; windows of 32 px\n1,2,0.1,0.2\n# more;\n3,4,0.1,0.3\n";
        let table = parse_field(text, "a").unwrap();
        assert_eq!((table.x, table.dy), (vec![1.0, 3.0], vec![0.2, 0.3]));
    }

    /// In mm y is up in the file as in the sheet, whoever wrote it.
    #[test]
    fn openpiv_in_millimetres_is_not_turned_over() {
        let text = "# x\ty\tu\tv\n-12\t7\t0.25\t0.3\n-10.5\t7\t0.25\t0.4\n-12\t5.5\t0.2\t0.1\n";
        let csv = parse_field(&text.replace("# ", "").replace('\t', ","), "a").unwrap();
        let mm = parse_field(text, "a").unwrap().in_unit(FieldUnit::Millimetres);
        assert_eq!((&mm.y, &mm.dy, mm.unit), (&csv.y, &csv.dy, Some(FieldUnit::Millimetres)));
        let px = parse_field(text, "a").unwrap();
        // Not whole: left where they are.
        assert_eq!(px.clone().in_unit(FieldUnit::DewarpedPixels).x, px.x);
        assert_eq!((&px.y, &px.dy), (&vec![5.5, 5.5, 7.0], &vec![-0.3, -0.4, -0.1]));
        assert_eq!(px.clone().in_unit(FieldUnit::DewarpedPixels).dy, px.dy);
    }

    #[test]
    fn separators_and_decimal_commas() {
        for text in [
            "x_mm;y_mm;dx_mm;dy_mm\n1,5;2;0,25;-1\n",
            "x_mm\ty_mm\tdx_mm\tdy_mm\n1.5\t2\t.25\t-1\n",
            "\u{feff}x_mm y_mm dx_mm dy_mm\r\n1.5 2 2.5e-1 -1\r\n",
        ] {
            let f = parse_field(text, "a").unwrap();
            assert_eq!((f.x[0], f.y[0], f.dx[0], f.dy[0]), (1.5, 2.0, 0.25, -1.0));
            assert_eq!(f.unit, Some(FieldUnit::Millimetres));
        }
        assert_eq!(parse_field("x,y,u,v\n1,2,3,4\n", "a").unwrap().unit, None);
    }

    #[test]
    fn no_sigma_is_left_unread() {
        let with = |columns: &str| message(&format!("x_px,y_px,dx_px,dy_px,{columns}\n1,2,3,4,0.1,0.1\n"));
        assert!(with("sigma_dx_px,w").contains("f.txt:1: column sigma_dx_px without sigma_dy_px"));
        assert!(with("a,sigma_dy_px").contains("column sigma_dy_px without sigma_dx_px"));
        let told = with("sigma_dx_mm,sigma_dy_mm");
        assert!(told.contains("column sigma_dx_mm") && told.contains("expected sigma_dx_px, sigma_dy_px"), "{told}");
        let read = |head: &str| parse_field(&format!("{head}\n1,2,3,4,0.1,0.2\n"), "a").unwrap().sigma;
        assert_eq!(read("x,y,u,v,sigma_v,sigma_u"), Some([vec![0.2], vec![0.1]]));
        assert_eq!(read("x,y,dx,dy,sigma_w,correlation"), None);
    }

    #[test]
    fn broken_files_say_where_and_what() {
        assert!(message("").contains("f.txt:1: the file is empty"));
        assert!(message("a,b,c\n1,2,3\n").contains("columns \"a, b, c\": expected a header x_px"));
        assert!(message("x_px,y_px,dx_px,dy_px\n1,2,3,4\n1,2,oops,4\n").contains("f.txt:3: \"oops\" is not a number"));
        let long = message(&format!("x_px,y_px,dx_px,dy_px\n1,2,{}\u{1b}[2J,4\n", "o".repeat(50)));
        assert!(long.contains("oo\\u{1b}[2J\" is not a number"), "{long}");
        assert!(message(&"nothing".repeat(9000)).len() < 400);
        assert_eq!(parse_field("x_px,y_px,dx_px,dy_px\r1,2,3,4\r5,6,7,8\r", "f").unwrap().x, [1.0, 5.0]);
        assert!(message("x_px,y_px,dx_px,dy_px\n1,2,3,4\n5,6\n").contains("f.txt:3: 2 columns"));
        let commas = message("x_mm,y_mm,dx_mm,dy_mm\n-12,0,7,0,0,247\n");
        assert!(
            commas.contains("f.txt:2: 6 cells, but the header names 4; are decimals written with commas?"),
            "{commas}"
        );
        // A mark at the end of every line is none.
        assert!(parse_field("x_px,y_px,dx_px,dy_px\n1,2,3,4,\n", "f.txt").is_ok());
        assert!(message("x_px,y_px,dx_px,dy_px\n").contains("no vector below"));
        assert!(message("x_px,y_px,dx_px,dy_px\nnan,2,3,4\n").contains("without a position"));
        assert!(
            message("PIVlab by\nFRAME\nx [m],y [m],u [m/s],v [m/s],Vector type [-]\n1,2,3,4,1\n")
                .contains("without its calibration")
        );
        assert!(message("PIVlab by\nFRAME\n").contains("no line with the names"));
    }
}
