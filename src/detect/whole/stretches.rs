//! The field in stretches of rows near edges, and where lines start.

use crate::lanes::{Kernel, Lanes};

/// Pixels of a stretch.
pub(super) const STRETCH: usize = 32;
/// Stretches that are passed over together where none has an edge.
const MANY: usize = 16;
/// Rows that nobody asks for after which sums of nine rows are made anew.
const ANEW: usize = 5;
/// Half width of the window of the local mean, px.
const R: usize = 4;
/// Binary digits of the field that are dropped.
const FIELD_SHIFT: i32 = 5;

/// A smoothed image, row by row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Smoothed<'a> {
    pub(super) data: &'a [u16],
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Smoothed<'_> {
    #[inline(always)]
    fn row(&self, v: usize) -> &[u16] {
        &self.data[v * self.width..][..self.width]
    }

    /// The field at any pixel.
    pub(super) fn field(&self, u: usize, v: usize) -> i16 {
        let mut sum = 0;
        for j in v.saturating_sub(R)..=v + R {
            // Rows and columns beyond the border are those at the border.
            let row = self.row(j.min(self.height - 1));
            let inner: u32 = (u.saturating_sub(R)..=u + R).map(|i| u32::from(row[i.min(self.width - 1)])).sum();
            let before = R.saturating_sub(u) as u32 * u32::from(row[0]);
            sum += (inner + before) * if j == 0 { 1 + R.saturating_sub(v) as u32 } else { 1 };
        }
        in_units(self.row(v)[u], sum)
    }
}

/// The field from a smoothed grey level and the sum of those around it.
#[inline(always)]
fn in_units(own: u16, sum: u32) -> i16 {
    let x = 81 * i32::from(own) - sum as i32;
    ((x + (1 << (FIELD_SHIFT - 1))) >> FIELD_SHIFT).clamp(-32_768, 32_767) as i16
}

/// What is carried along from row to row, and from one band to the next below it.
pub(super) struct Finder {
    sums: Sums,
    /// Which stretches are steep, of three rows in a ring.
    steep: [Vec<bool>; 3],
    /// The row that comes next.
    next: Option<usize>,
}

impl Finder {
    pub(super) fn new(width: usize) -> Self {
        let columns = vec![0; width.next_multiple_of(STRETCH) + 2 * R];
        Self {
            sums: Sums { columns, next: 0 },
            steep: [0; 3].map(|_| vec![false; width.div_ceil(STRETCH)]),
            next: None,
        }
    }

    /// Makes ready for row `v`.
    #[inline(always)]
    fn start_at(&mut self, on: &Smoothed<'_>, v: usize, least: u16) {
        if self.next != Some(v) {
            self.sums.start_at(on, v);
            self.steep.iter_mut().for_each(|steep| steep.fill(false));
            for k in v.saturating_sub(1)..=v {
                find_steep(on.row(k), least, &mut self.steep[k % 3]);
            }
        }
    }
}

/// What is known of some rows.
pub(super) struct Found<'a> {
    /// Which stretches of the field are kept, row by row.
    pub(super) kept: &'a mut [bool],
    /// The field, row by row in whole stretches; of those that are not kept whatever was there.
    pub(super) field: &'a mut [i16],
    /// Where lines start, places `v * width + u`.
    pub(super) starts: &'a mut Vec<u32>,
}

/// Finds what there is of as many rows as there is room for, from `first` on; a line may start where neighbours differ by more than `least`.
pub(super) struct Find<'a> {
    pub(super) on: Smoothed<'a>,
    pub(super) first: usize,
    pub(super) least: u16,
    pub(super) finder: &'a mut Finder,
    pub(super) out: Found<'a>,
}

impl Kernel for Find<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { on, first, least, finder, out: Found { kept, field, starts } } = self;
        let count = on.width.div_ceil(STRETCH);
        starts.clear();
        finder.start_at(&on, first, least);
        let Finder { sums, steep, next } = finder;
        let rows = kept.chunks_exact_mut(count).zip(field.chunks_exact_mut(count * STRETCH));
        for (k, (kept, field)) in rows.enumerate() {
            let v = first + k;
            match v + 1 < on.height {
                true => find_steep(on.row(v + 1), least, &mut steep[(v + 1) % 3]),
                false => steep[(v + 1) % 3].fill(false),
            }
            let of_three = steep[0].iter().zip(&steep[1]).zip(&steep[2]);
            for (kept, ((a, b), c)) in kept.iter_mut().zip(of_three) {
                *kept = *a | *b | *c;
            }
            let (row, field) = (on.row(v), field.as_chunks_mut().0);
            let any = kept.contains(&true);
            if any {
                sums.go_to(&on, v);
            }
            let mut from = if any { 0 } else { count };
            while from < count {
                let (first, end) = (from, (from + MANY).min(count));
                from = end;
                if none(&kept[first..end]) {
                    continue;
                }
                for k in first..end {
                    if kept[k] {
                        let mut border = [0; STRETCH + 1];
                        field[k] = sums.field(k, pixels(row, k, &mut border));
                    }
                }
            }
            if v + 1 < on.height {
                find_starts::<L>(&on, v, (&steep[v % 3], least), (kept, field.as_flattened_mut()), starts);
            }
            *next = Some(v + 1);
        }
    }
}

/// Whether none is set, of many several at once.
#[inline(always)]
fn none(list: &[bool]) -> bool {
    match list.first_chunk::<MANY>() {
        Some(many) => *many == [false; MANY],
        None => false,
    }
}

/// The pixels of a stretch of a row and one more; beyond the border the last one again.
#[inline(always)]
fn pixels<'a>(row: &'a [u16], k: usize, border: &'a mut [u16; STRETCH + 1]) -> &'a [u16; STRETCH + 1] {
    let inner = &row[k * STRETCH..];
    if let Some(whole) = inner.first_chunk() {
        return whole;
    }
    border.fill(row[row.len() - 1]);
    border[..inner.len()].copy_from_slice(inner);
    border
}

/// Which stretches of a row hold a pixel that differs from the next by more than `least`.
#[inline(always)]
fn find_steep(row: &[u16], least: u16, steep: &mut [bool]) {
    for (k, steep) in steep.iter_mut().enumerate() {
        let mut border = [0; STRETCH + 1];
        let x = pixels(row, k, &mut border);
        // A plain loop, for vectors; whether one bit of all is set is asked more easily than what the largest is.
        let mut more = 0;
        for i in 0..STRETCH {
            more |= (x[i].max(x[i + 1]) - x[i].min(x[i + 1])).saturating_sub(least);
        }
        *steep = more != 0;
    }
}

/// Sums of nine rows, carried along from row to row; four columns repeat the border in front, and behind those that fill the last stretch.
struct Sums {
    columns: Vec<u32>,
    next: usize,
}

impl Sums {
    /// To begin with row `v`.
    #[inline(always)]
    fn start_at(&mut self, on: &Smoothed<'_>, v: usize) {
        self.columns.fill(0);
        for j in 0..=2 * R {
            // The rows of the one before.
            let row = on.row((v + j).saturating_sub(R + 1).min(on.height - 1));
            self.columns[R..].iter_mut().zip(row).for_each(|(c, x)| *c += u32::from(*x));
        }
        self.next = v;
    }

    /// On to those of row `v`; where nobody asked for many rows they are summed up anew.
    #[inline(always)]
    fn go_to(&mut self, on: &Smoothed<'_>, v: usize) {
        if v > self.next + ANEW {
            self.start_at(on, v);
        }
        while self.next <= v {
            self.next_row(on);
        }
    }

    #[inline(always)]
    fn next_row(&mut self, on: &Smoothed<'_>) {
        let (v, last) = (self.next, on.height - 1);
        let (new, old) = (on.row((v + R).min(last)), on.row(v.saturating_sub(R + 1)));
        let columns = &mut self.columns[R..R + on.width];
        for (i, c) in columns.iter_mut().enumerate() {
            *c = *c + u32::from(new[i]) - u32::from(old[i]);
        }
        let (first, last) = (columns[0], columns[on.width - 1]);
        self.columns[..R].fill(first);
        self.columns[R + on.width..].fill(last);
        self.next += 1;
    }

    /// The field of stretch `k`, of which these are the pixels.
    #[inline(always)]
    fn field(&self, k: usize, own: &[u16; STRETCH + 1]) -> [i16; STRETCH] {
        let c = &self.columns[k * STRETCH..][..STRETCH + 2 * R];
        let mut out = [0; STRETCH];
        for i in 0..STRETCH {
            let sum = c[i] + c[i + 1] + c[i + 2] + c[i + 3] + c[i + 4] + c[i + 5] + c[i + 6] + c[i + 7] + c[i + 8];
            out[i] = in_units(own[i], sum);
        }
        out
    }
}

/// Places of row `v` where a line starts, from what is kept of it.
#[inline(always)]
fn find_starts<L: Lanes>(
    on: &Smoothed<'_>,
    v: usize,
    (steep, least): (&[bool], u16),
    (kept, field): (&[bool], &mut [i16]),
    out: &mut Vec<u32>,
) {
    let (row, mut next) = (on.row(v), 0);
    while next < steep.len() {
        let (begin, end) = (next, (next + MANY).min(steep.len()));
        next = end;
        if none(&steep[begin..end]) {
            continue;
        }
        for k in (begin..end).filter(|k| steep[*k]) {
            let (mut border, mut at_end) = ([0; STRETCH + 1], [0; STRETCH + 1]);
            let (x, from, end) = (pixels(row, k, &mut border), k * STRETCH, (k + 1) * STRETCH);
            // Beyond a border, and where it is not steep, no line starts. Of a stretch that is not kept the memory is there to be used.
            if end < on.width && !kept[k + 1] {
                let last = STRETCH - 1;
                field[end] = if x[last].abs_diff(x[STRETCH]) > least { on.field(end, v) } else { field[end - 1] };
            }
            let f = match field[from..].first_chunk::<{ STRETCH + 1 }>() {
                Some(more) => more,
                None => {
                    at_end[..STRETCH].copy_from_slice(&field[from..end]);
                    at_end[STRETCH] = field[end - 1];
                    &at_end
                }
            };
            let mut hits = [0; STRETCH];
            for i in 0..STRETCH {
                hits[i] = start(x[i], x[i + 1], f[i], f[i + 1], least);
            }
            let mut bits = L::bits_of(&hits);
            let first = (v * on.width + from) as u32;
            while bits != 0 {
                out.push(first + bits.trailing_zeros());
                bits &= bits - 1;
            }
        }
    }
}

/// Not zero where two neighbours differ by more than `least` and a line runs between them.
#[inline(always)]
fn start(s: u16, t: u16, f: i16, g: i16, least: u16) -> u16 {
    let steep = (s.max(t) - s.min(t)).saturating_sub(least);
    if (f > 0) != (g > 0) { steep } else { 0 }
}
