use super::image::Image;
use crate::math;

/// Maximum number of edge points of a search; the strongest are kept.
pub const MAX_EDGES: usize = 1280;

/// Minimum squared gradient of an edge, in Sobel's units on cells with [`FRACTION`]: some 5 grey levels.
const THRESHOLD: u32 = 300 * 300;
/// Units of a cell per grey level.
const FRACTION: u32 = 16;
/// Number of 16-bit rows that the computation stores: cells, and both components of the gradient.
const ROWS: usize = 9;
/// Buckets of the histogram of squared gradients, four for each power of two.
const BUCKETS: usize = 128;

/// Elements of [`Scratch::rows`](super::Scratch::rows) for images of this width [px].
pub const fn row_len(width: usize) -> usize {
    ROWS * (width / 2)
}

/// A point of an edge.
#[derive(Clone, Copy, Debug, Default)]
pub struct EdgePoint {
    /// Cell.
    pub(super) x: u16,
    pub(super) y: u16,
    /// Direction of the gradient, of length 127.
    pub(super) gx: i8,
    pub(super) gy: i8,
    /// Weight of its votes, 1 to 8.
    pub(super) weight: u8,
    bucket: u8,
}

impl EdgePoint {
    /// An empty entry, for buffers.
    pub const NONE: Self = Self { x: 0, y: 0, gx: 0, gy: 0, weight: 0, bucket: 0 };
}

/// A rectangle of cells: from (inclusive), to (exclusive).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cells {
    pub from: [usize; 2],
    pub to: [usize; 2],
}

impl Cells {
    pub const fn width(&self) -> usize {
        self.to[0].saturating_sub(self.from[0])
    }

    pub const fn height(&self) -> usize {
        self.to[1].saturating_sub(self.from[1])
    }
}

/// Edge points in the image reduced by 2^`level`, `level` at least 1, in a rectangle of cells: local maxima
/// of Sobel's gradient across the edge. Returns their number; if there are too many, the strongest are kept.
pub(super) fn edges(
    image: &Image<'_>,
    level: u32,
    cells: &Cells,
    rows: &mut [i16],
    points: &mut [EdgePoint],
) -> usize {
    let width = cells.width();
    if width < 3 || cells.height() < 3 {
        return 0;
    }
    let mut list = List::new(points);
    let (binned, gradients) = rows.split_at_mut((3 * width).min(rows.len()));
    for (index, y) in (cells.from[1]..cells.to[1]).enumerate() {
        reduce(image, level, y, cells.from[0], row(binned, width, index));
        if index < 2 {
            continue;
        }
        let above: &[i16] = row_of(binned, width, index - 2);
        let here: &[i16] = row_of(binned, width, index - 1);
        let below: &[i16] = row_of(binned, width, index);
        let (gx, gy) = row(gradients, 2 * width, index).split_at_mut(width);
        sobel(above, here, below, gx, gy);
        if index >= 4 {
            let [above, here, below] =
                [2, 1, 0].map(|back| row_of(gradients, 2 * width, index - back).split_at(width));
            maxima(above, here, below, cells.from[0], y - 2, &mut list);
        }
    }
    list.weigh();
    list.length
}

/// The `index`-th of rows in a ring of three.
fn row(ring: &mut [i16], width: usize, index: usize) -> &mut [i16] {
    let start = index % 3 * width;
    ring.get_mut(start..start + width).unwrap_or_default()
}

fn row_of(ring: &[i16], width: usize, index: usize) -> &[i16] {
    let start = index % 3 * width;
    ring.get(start..start + width).unwrap_or_default()
}

/// A row of cells: means of 2^level × 2^level pixels.
fn reduce(image: &Image<'_>, level: u32, y: usize, from: usize, cells: &mut [i16]) {
    let side = 1 << level;
    if level == 1 {
        let (upper, lower) = (image.row(2 * y), image.row(2 * y + 1));
        let (upper, lower) =
            (upper.get(2 * from..).unwrap_or_default(), lower.get(2 * from..).unwrap_or_default());
        let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
        for (cell, (a, b)) in cells.iter_mut().zip(pairs) {
            if let ([a, b], [c, d]) = (a, b) {
                let sum = i16::from(*a) + i16::from(*b) + i16::from(*c) + i16::from(*d);
                *cell = sum * (FRACTION as i16 / 4);
            }
        }
        return;
    }
    cells.fill(0);
    // At level 2 the sum of 16 pixels already has the scale of a cell. At every level the sum over all rows
    // is at most 16 · 255.
    let shift = 2 * level - 4;
    for line in 0..side {
        let pixels = image.row(side * y + line).get(side * from..).unwrap_or_default();
        for (cell, block) in cells.iter_mut().zip(pixels.chunks_exact(side)) {
            let sum: u32 = block.iter().map(|&pixel| u32::from(pixel)).sum();
            // Rounding down in each line costs less than a sixteenth of a grey level.
            *cell += (sum >> shift) as i16;
        }
    }
}

/// Sobel's operator. The first and last elements remain 0.
fn sobel(above: &[i16], here: &[i16], below: &[i16], gx: &mut [i16], gy: &mut [i16]) {
    let width = here.len().min(above.len()).min(below.len()).min(gx.len()).min(gy.len());
    if width < 3 {
        return;
    }
    let (above, here, below) = (&above[..width], &here[..width], &below[..width]);
    let (gx, gy) = (&mut gx[..width], &mut gy[..width]);
    for x in 1..width - 1 {
        gx[x] =
            (above[x + 1] - above[x - 1]) + 2 * (here[x + 1] - here[x - 1]) + (below[x + 1] - below[x - 1]);
        gy[x] = (below[x - 1] - above[x - 1]) + 2 * (below[x] - above[x]) + (below[x + 1] - above[x + 1]);
    }
    gx[0] = 0;
    gy[0] = 0;
    gx[width - 1] = 0;
    gy[width - 1] = 0;
}

type Gradients<'a> = (&'a [i16], &'a [i16]);

#[inline]
fn squared(gradients: Gradients<'_>, x: usize) -> u32 {
    let (gx, gy) = (i32::from(gradients.0[x]), i32::from(gradients.1[x]));
    (gx * gx + gy * gy) as u32
}

/// Appends the points of a row whose gradient exceeds the threshold and is a maximum across the edge.
fn maxima(
    above: Gradients<'_>,
    here: Gradients<'_>,
    below: Gradients<'_>,
    from: usize,
    y: usize,
    list: &mut List<'_>,
) {
    let width = here.0.len();
    if [above.0, above.1, here.1, below.0, below.1].iter().any(|row| row.len() != width) {
        return;
    }
    for x in 1..width.saturating_sub(1) {
        let magnitude = squared(here, x);
        if magnitude < THRESHOLD {
            continue;
        }
        let (gx, gy) = (i32::from(here.0[x]), i32::from(here.1[x]));
        let (wide, high) = (gx.abs(), gy.abs());
        let (one, other) = if wide > 2 * high {
            (squared(here, x - 1), squared(here, x + 1))
        } else if high > 2 * wide {
            (squared(above, x), squared(below, x))
        } else if (gx > 0) == (gy > 0) {
            (squared(above, x - 1), squared(below, x + 1))
        } else {
            (squared(above, x + 1), squared(below, x - 1))
        };
        if magnitude >= one && magnitude > other {
            list.push((from + x) as u16, y as u16, gx, gy, magnitude);
        }
    }
}

/// The strongest edge points so far.
struct List<'a> {
    points: &'a mut [EdgePoint],
    length: usize,
    histogram: [u32; BUCKETS],
    /// Points of lower buckets are dropped.
    min_bucket: u8,
    /// Of the points of that bucket every `stride`-th is kept; the number of those dropped since the last.
    stride: u32,
    skipped: u32,
}

impl<'a> List<'a> {
    fn new(points: &'a mut [EdgePoint]) -> Self {
        Self { points, length: 0, histogram: [0; BUCKETS], min_bucket: 0, stride: 1, skipped: 0 }
    }

    fn push(&mut self, x: u16, y: u16, gx: i32, gy: i32, magnitude: u32) {
        let power = 31 - magnitude.leading_zeros();
        let bucket = (4 * power + (magnitude >> (power - 2) & 3)) as u8;
        if !self.keeps(bucket) {
            return;
        }
        if self.length >= self.points.len() {
            self.drop_weakest();
            if bucket < self.min_bucket {
                return;
            }
        }
        let scale = 127.0 / math::inlined_sqrt(magnitude as f32);
        let [gx, gy] = [gx, gy].map(|component| math::round(component as f32 * scale) as i8);
        if let Some(point) = self.points.get_mut(self.length) {
            *point = EdgePoint { x, y, gx, gy, weight: 0, bucket };
            self.length += 1;
            self.histogram[usize::from(bucket) % BUCKETS] += 1;
        }
    }

    /// Whether a point is strong enough to be kept, and of many weak ones the next.
    #[inline]
    fn keeps(&mut self, bucket: u8) -> bool {
        if bucket != self.min_bucket || self.stride == 1 {
            return bucket >= self.min_bucket;
        }
        self.skipped += 1;
        if self.skipped < self.stride {
            return false;
        }
        self.skipped = 0;
        true
    }

    /// Drops the weakest points: whole buckets, until they are an eighth of all, but not the strongest one.
    /// If all points are in that, drops every second.
    fn drop_weakest(&mut self) {
        let strongest = self.histogram.iter().rposition(|&count| count > 0).unwrap_or(0);
        let mut dropped = 0;
        while dropped < self.length.div_ceil(8) && usize::from(self.min_bucket) < strongest {
            let count = &mut self.histogram[usize::from(self.min_bucket)];
            dropped += *count as usize;
            *count = 0;
            self.min_bucket += 1;
        }
        let thins = dropped == 0;
        (self.stride, self.skipped) = (if thins { 2 * self.stride } else { 1 }, 0);
        let mut kept = 0;
        for index in (0..self.length).step_by(if thins { 2 } else { 1 }) {
            let point = self.points[index];
            if point.bucket >= self.min_bucket {
                self.points[kept] = point;
                kept += 1;
            }
        }
        if thins {
            self.histogram[strongest] = kept as u32;
        }
        self.length = kept;
    }

    /// Sets the weights: the squared gradient in powers of two, 4 at the median, 1 to 8.
    fn weigh(&mut self) {
        let (mut below, mut median) = (0, 0);
        for (bucket, &count) in self.histogram.iter().enumerate() {
            below += count as usize;
            if 2 * below >= self.length {
                median = bucket;
                break;
            }
        }
        for point in self.points.iter_mut().take(self.length) {
            // Four buckets double the square; the median has the weight 4.
            let quarters = i32::from(point.bucket) - median as i32 + 8;
            point.weight = if quarters < 0 { 1 } else { 1 << (quarters / 4).min(3) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What remains of points of these gradients, pushed with increasing x.
    fn kept(capacity: usize, gradients: impl IntoIterator<Item = i32>) -> Vec<EdgePoint> {
        let mut points = std::vec![EdgePoint::NONE; capacity];
        let mut list = List::new(&mut points);
        for (x, gradient) in (0_usize..).zip(gradients) {
            list.push(x as u16, 0, gradient, 0, (gradient * gradient) as u32);
        }
        let length = list.length;
        points.truncate(length);
        points
    }

    #[test]
    fn the_strongest_points_are_kept_even_if_most_are_equally_strong() {
        let points = kept(64, [100; 20].into_iter().chain([200; 60]));
        assert!(points.len() == 60 && points.iter().all(|point| point.x >= 20));
        let points = kept(64, [200; 64].into_iter().chain([400]));
        assert_eq!((points.len(), points.last().map(|point| point.x)), (33, Some(64)));
        // Those of a stronger bucket take the place of a thinned one.
        let points = kept(64, [200; 500].into_iter().chain([400; 60]));
        assert_eq!(points.iter().filter(|point| point.x >= 500).count(), 60);
    }

    #[test]
    fn equally_strong_points_are_thinned_alike_everywhere() {
        let points = kept(64, [100; 1000]);
        assert!(points.len() > 32, "{}", points.len());
        let gaps = points.windows(2).map(|pair| pair[1].x - pair[0].x);
        let [min, max] = gaps.fold([u16::MAX, 0], |[min, max], gap| [min.min(gap), max.max(gap)]);
        assert!(min >= 8 && max <= 32, "{min} to {max}");
    }

    #[test]
    fn a_large_picture_may_have_any_number_of_points_of_one_strength() {
        assert_eq!(kept(70_000, (0..70_000).map(|_| 100)).len(), 70_000);
    }
}
