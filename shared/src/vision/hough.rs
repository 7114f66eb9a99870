use super::edges::{Cells, EdgePoint};
use crate::math;

/// Maximum number of centres of a level.
pub(super) const MAX_CENTERS: usize = 12;
/// Maximum number of radii of a level, in cells.
const MAX_RADII: usize = 40;
/// Minimum distance of two centres, in cells.
const SEPARATION: i32 = 2;
/// Squared cosine of the largest angle between a gradient and the direction to the centre: 25°.
const ALIGNMENT: f32 = 0.82;

/// Elements of [`Scratch::accumulator`](super::Scratch::accumulator) for images of this size [px].
pub const fn accumulator_len(width: usize, height: usize) -> usize {
    (width / 2) * (height / 2)
}

/// A candidate for a circle, in cells.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HoughCircle {
    pub x: f32,
    pub y: f32,
    pub radius: f32,
    /// Number of sectors, of 32, with edge points of the circle.
    pub sectors: u32,
}

/// Lets the edge points vote for centres at `radii` along ± their gradient. The accumulator covers the cells
/// `centers`.
pub(super) fn vote(points: &[EdgePoint], centers: &Cells, radii: [usize; 2], accumulator: &mut [u16]) {
    let (width, height) = (centers.width(), centers.height());
    let Some(accumulator) = accumulator.get_mut(..width * height) else { return };
    accumulator.fill(0);
    for point in points {
        // 16 bits of fraction; half a cell is added so that truncation rounds.
        let x = ((i32::from(point.x) - centers.from[0] as i32) << 16) + 0x8000;
        let y = ((i32::from(point.y) - centers.from[1] as i32) << 16) + 0x8000;
        let (dx, dy) = (i32::from(point.gx) * 516, i32::from(point.gy) * 516);
        let weight = u16::from(point.weight);
        for (dx, dy) in [(dx, dy), (-dx, -dy)] {
            let (mut x, mut y) = (x + dx * radii[0] as i32, y + dy * radii[0] as i32);
            for _ in radii[0]..=radii[1] {
                let (column, row) = ((x >> 16) as usize, (y >> 16) as usize);
                if column < width && row < height {
                    let cell = &mut accumulator[row * width + column];
                    *cell = cell.saturating_add(weight);
                }
                x += dx;
                y += dy;
            }
        }
    }
}

/// Maxima of the accumulator, smoothed over 3 × 3 cells, the largest first; cells as (column, row, votes).
pub(super) fn maxima(centers: &Cells, accumulator: &[u16]) -> [(i32, i32, u32); MAX_CENTERS] {
    let width = centers.width();
    let mut best = [(0, 0, 0); MAX_CENTERS];
    let rows = accumulator.chunks_exact(width.max(1)).take(centers.height());
    let mut rows = rows.enumerate();
    let (mut above, mut here) = match (rows.next(), rows.next()) {
        (Some((_, above)), Some((_, here))) => (above, here),
        _ => return best,
    };
    for (row, below) in rows {
        let mut columns = [0_u32; 3];
        for (x, ((a, b), c)) in above.iter().zip(here).zip(below).enumerate() {
            columns = [columns[1], columns[2], u32::from(*a) + 2 * u32::from(*b) + u32::from(*c)];
            let votes = columns[0] + 2 * columns[1] + columns[2];
            if x >= 2 && votes > best[MAX_CENTERS - 1].2 {
                let cell = ((centers.from[0] + x) as i32 - 1, (centers.from[1] + row) as i32 - 1, votes);
                insert(&mut best, cell);
            }
        }
        (above, here) = (here, below);
    }
    best
}

/// Inserts a cell; keeps the list sorted and its members apart.
fn insert(best: &mut [(i32, i32, u32); MAX_CENTERS], cell: (i32, i32, u32)) {
    let is_near = |known: &(i32, i32, u32)| {
        known.2 > 0 && (known.0 - cell.0).abs() < SEPARATION && (known.1 - cell.1).abs() < SEPARATION
    };
    if best.iter().any(|known| is_near(known) && known.2 >= cell.2) {
        return;
    }
    let mut kept = 0;
    for index in 0..MAX_CENTERS {
        if !is_near(&best[index]) {
            best[kept] = best[index];
            kept += 1;
        }
    }
    best[kept..].fill((0, 0, 0));
    let place = best.iter().position(|known| known.2 < cell.2).unwrap_or(MAX_CENTERS - 1);
    best[place..].rotate_right(1);
    best[place] = cell;
}

/// The sector of a direction, one of 32.
#[inline]
const fn sector(dx: i32, dy: i32) -> u32 {
    let (wide, high) = (dx.abs(), dy.abs());
    let (larger, smaller) = if wide > high { (wide, high) } else { (high, wide) };
    // Tangents of 11.25°, 22.5° and 33.75°, times 64.
    let tangent = 64 * smaller;
    let part =
        (tangent > 13 * larger) as u32 + (tangent > 27 * larger) as u32 + (tangent > 43 * larger) as u32;
    let octant = (wide > high) as u32 + 2 * ((dx > 0) as u32) + 4 * ((dy > 0) as u32);
    4 * octant + part
}

/// Counts, for the circles about a centre, the sectors in which edge points point at it.
pub(super) fn radii_about(
    points: &[EdgePoint],
    center: (i32, i32),
    radii: [usize; 2],
    mut found: impl FnMut(HoughCircle),
) {
    let mut seen = [0_u32; MAX_RADII];
    let from = radii[0].saturating_sub(2) as i32;
    let to = (radii[1] + 2) as i32;
    for point in points {
        let (dx, dy) = (i32::from(point.x) - center.0, i32::from(point.y) - center.1);
        let squared = dx * dx + dy * dy;
        if squared < from * from || squared > to * to {
            continue;
        }
        let along = dx * i32::from(point.gx) + dy * i32::from(point.gy);
        if ((along * along) as f32) < ALIGNMENT * 127.0 * 127.0 * squared as f32 {
            continue;
        }
        let radius = math::round(math::inlined_sqrt(squared as f32)) as i32 - from;
        if let Some(seen) = seen.get_mut(radius as usize) {
            *seen |= 1 << sector(dx, dy);
        }
    }
    let count = |radius: usize| {
        let part = seen.get(radius.saturating_sub(1)..radius + 2).unwrap_or_default();
        part.iter().fold(0, |all, &one| all | one).count_ones()
    };
    for radius in 1..MAX_RADII - 1 {
        let sectors = count(radius);
        let cells = radius as f32 + from as f32;
        if sectors >= 10
            && sectors >= count(radius - 1)
            && sectors > count(radius + 1)
            && cells + 1.5 >= radii[0] as f32
            && cells <= radii[1] as f32 + 1.5
        {
            found(HoughCircle { x: center.0 as f32, y: center.1 as f32, radius: cells, sectors });
        }
    }
}
