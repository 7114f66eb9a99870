//! The image along an ellipse: its derivative across the rim.

use super::ellipse::Ellipse;
use super::image::Image;
use crate::math;

/// Maximum number of rays from the centre.
pub(super) const RAYS: usize = 64;
/// Rays on which candidates are compared.
pub(super) const FEW_RAYS: usize = 32;
/// Cosine and sine of the angle between two rays.
const TURN: [f32; 2] = [0.995_184_7, 0.098_017_14];
/// Maximum number of steps of a ray to each side of the ellipse.
pub(super) const MAX_HALF: usize = 4;
/// Samples of a ray.
pub(super) const PLACES: usize = 2 * MAX_HALF + 1;
/// Unit of [`Ring::contrasts`]: the value for a contrast of one grey level.
const GREY_LEVEL: f32 = 48.0;
/// Standard deviation of a contrast, over that of the pixels.
pub(super) const CONTRAST_NOISE: f32 = 0.5;
/// Measured contrast of an edge with a blur of 1 px in steps of half a pixel, relative to whole steps.
const HALF_STEPS: f32 = 0.6;
/// The common contrast is that of rays a 16th of the circle apart.
const APART: usize = 16;
/// Minimum contrast of an edge point [grey levels].
const MIN_CONTRAST: f32 = 3.0;

/// Directions of `N` rays, each rotated from the previous one; those of 32 are every other one of 64.
const fn evenly<const N: usize>() -> [[f32; 2]; N] {
    let [cos, sin] = TURN;
    let mut directions = [[1.0, 0.0]; N];
    let [mut u, mut v] = directions[0];
    let mut ray = 0;
    while ray < RAYS {
        if ray % (RAYS / N) == 0 {
            directions[ray * N / RAYS] = [u, v];
        }
        [u, v] = [u * cos - v * sin, u * sin + v * cos];
        ray += 1;
    }
    directions
}

/// Directions of `rays` rays, 32 or 64.
pub(super) fn directions(rays: usize) -> &'static [[f32; 2]] {
    static FEW: [[f32; 2]; FEW_RAYS] = evenly();
    static ALL: [[f32; 2]; RAYS] = evenly();
    if rays == FEW_RAYS { &FEW } else { &ALL }
}

/// The ray among 64 with the direction of this one of 32.
pub(super) const fn every_other(ray: usize) -> usize {
    ray * (RAYS / FEW_RAYS)
}

/// Minimum contrast of an edge point [grey levels].
pub(super) fn min_contrast(noise: f32) -> f32 {
    math::clamp(1.5 * CONTRAST_NOISE * noise, MIN_CONTRAST, 255.0)
}

/// The annulus about an ellipse.
pub(super) struct Ring {
    ellipse: Ellipse,
    rays: usize,
    half: usize,
    unit: f32,
    /// Distances of the ellipse from its centre along the rays [px].
    polar_radii: [f32; RAYS],
    /// Rays inside the image, one bit each.
    pub visible: u64,
    /// Derivative outwards, smoothed along the ellipse: the contrast of a sharp edge there. One more than
    /// there are rays, for [`Self::smooth`].
    contrasts: [[i16; PLACES]; RAYS + 1],
}

impl Ring {
    /// Samples `half` steps of `unit` px to both sides of an ellipse, on 32 or 64 rays.
    pub fn new(image: &Image<'_>, ellipse: &Ellipse, rays: usize, (half, unit): (usize, f32)) -> Self {
        let half = half.min(MAX_HALF);
        let mut ring = Self {
            ellipse: *ellipse,
            rays,
            half,
            unit,
            polar_radii: [0.0; RAYS],
            visible: 0,
            contrasts: [[0; PLACES]; RAYS + 1],
        };
        let root = ellipse.root();
        for (polar_radius, direction) in ring.polar_radii.iter_mut().zip(directions(rays)) {
            *polar_radius = ellipse.polar_radius(root, *direction);
        }
        let (mut visible, mut greys) = (0, [0; PLACES + 4]);
        let places = ring.contrasts.iter_mut().zip(&ring.polar_radii).zip(directions(rays)).enumerate();
        for (ray, ((contrasts, polar_radius), direction)) in places {
            if sample(image, ellipse, (*direction, *polar_radius), (half, unit), &mut greys) {
                // Also beyond `half`, where the values are unused: a fixed number is faster.
                for (place, contrast) in contrasts.iter_mut().enumerate() {
                    let difference = |away: usize| greys[place + 2 + away] - greys[place + 2 - away];
                    *contrast = (2 * difference(1) + difference(2)) as i16;
                }
                visible |= 1 << ray;
            }
        }
        ring.visible = visible;
        ring.smooth();
        ring
    }

    /// Smooths along the ellipse with weights 1, 2, 1; a neighbour outside the image is replaced by the ray
    /// itself.
    fn smooth(&mut self) {
        let rays = self.rays.min(RAYS);
        let sees = |ray: usize| self.visible >> ray & 1 == 1;
        // Sums of neighbours, in the place of the second one; what is outside is replaced by the other.
        self.contrasts[rays] = self.contrasts[0];
        let mut sees_next = sees(0);
        for ray in (0..rays).rev() {
            let sees_here = sees(ray);
            let one = if sees_here { ray } else { ray + 1 };
            let other = if sees_next { ray + 1 } else { ray };
            let (one, other) = (self.contrasts[one], self.contrasts[other]);
            for (sum, (one, other)) in self.contrasts[ray + 1].iter_mut().zip(one.iter().zip(&other)) {
                *sum = one + other;
            }
            sees_next = sees_here;
        }
        self.contrasts[0] = self.contrasts[rays];
        for ray in 0..rays {
            let after = self.contrasts[ray + 1];
            for (contrast, after) in self.contrasts[ray].iter_mut().zip(&after) {
                *contrast = ((i32::from(*contrast) + i32::from(*after)) >> 2) as i16;
            }
        }
    }

    /// Contrasts along a ray, from the inside [grey levels], if it is in the image.
    pub fn contrasts(&self, ray: usize) -> Option<[f32; PLACES]> {
        let contrasts = self.contrasts.get(ray).filter(|_| self.visible >> ray & 1 == 1)?;
        Some(contrasts.map(|contrast| f32::from(contrast) * (1.0 / GREY_LEVEL)))
    }

    /// Weight of an edge at each sample of a ray: half as much at the ends as in the middle.
    fn worth(&self) -> [i32; PLACES] {
        let middle = self.half as i32;
        let falloff = 512 / (middle * middle).max(1);
        let mut worth = [0; PLACES];
        for (worth, away) in worth.iter_mut().zip(-middle..=middle) {
            *worth = 1024 - falloff * away * away;
        }
        worth
    }

    /// Offset from the ellipse, in steps, of the strongest edge along a ray; `worth` is [`Self::worth`].
    fn edge(&self, contrasts: &[i16; PLACES], worth: &[i32; PLACES], min: i32) -> Option<f32> {
        let (mut best, mut at) = (0, 0);
        for (index, (contrast, worth)) in contrasts.iter().zip(worth).enumerate() {
            let score = i32::from(*contrast).abs() * worth;
            if score > best {
                (best, at) = (score, index);
            }
        }
        if at == 0 || at >= 2 * self.half {
            return None;
        }
        let heights = [at - 1, at, at + 1].map(|at| i32::from(contrasts[at]).abs());
        if heights[1] < min {
            return None;
        }
        Some((at as i32 - self.half as i32) as f32 + peak(heights.map(|height| height as f32)))
    }

    /// Edge points (x, y) with weights 0 or 1; 0 if `front` hides them. `None` if there are too few.
    pub fn edge_points(&self, noise: f32, front: Option<&Ellipse>) -> Option<[([f32; 2], f32); RAYS]> {
        let mut points = [([0.0; 2], 0.0); RAYS];
        let min = min_contrast(noise) * GREY_LEVEL;
        let min = (if self.unit < 1.0 { HALF_STEPS * min } else { min }) as i32;
        let worth = self.worth();
        let mut count = 0;
        let rays = directions(self.rays).iter().zip(&self.polar_radii).zip(&self.contrasts).zip(&mut points);
        for (ray, (((&direction, polar_radius), contrasts), (point, weight))) in rays.enumerate() {
            if self.visible >> ray & 1 == 0 {
                continue;
            }
            if let Some(offset) = self.edge(contrasts, &worth, min) {
                let polar_radius = polar_radius + offset * self.unit;
                *point = self.ellipse.point(direction, polar_radius);
                if !front.is_some_and(|front| hides(front, *point)) {
                    *weight = 1.0;
                    count += 1;
                }
            }
        }
        (count >= self.rays / 5).then_some(points)
    }

    /// Rays whose point on the ellipse is in the image and not hidden by `front`.
    pub fn open(&self, front: Option<&Ellipse>) -> u64 {
        let Some(front) = front else { return self.visible };
        let is_hidden = |direction, polar_radius| hides(front, self.ellipse.point(direction, polar_radius));
        let hidden = (0..).zip(directions(self.rays).iter().zip(&self.polar_radii)).fold(
            0,
            |mask, (ray, (&direction, &polar_radius))| {
                mask | u64::from(is_hidden(direction, polar_radius)) << ray
            },
        );
        self.visible & !hidden
    }

    /// Features of a rim on the ellipse. The ring must have the maximum number of steps, each of 1 px.
    pub fn rim(&self, noise: f32, front: Option<&Ellipse>) -> RimFeatures {
        let open = self.open(front);
        let count = open.count_ones();
        let scale = 1.0 / (min_contrast(noise) * GREY_LEVEL);
        let mut sum = RimFeatures::default();
        let (mut gap, mut widest) = (0.0, 0.0_f32);
        for (ray, contrasts) in self.contrasts.iter().enumerate().take(self.rays) {
            if open >> ray & 1 == 0 {
                continue;
            }
            let signed = contrasts.map(|contrast| f32::from(contrast) * scale);
            let other = (ray + self.rays / APART) % self.rays;
            if open >> other & 1 == 1 {
                sum.common += common(signed[MAX_HALF], f32::from(self.contrasts[other][MAX_HALF]) * scale);
            }
            let offset = sum.add(&signed);
            gap = if offset > 1.0 { gap + 1.0 } else { 0.0 };
            widest = widest.max(gap);
        }
        let mean = 1.0 / count.max(1) as f32;
        sum.means(mean, count as f32 / self.rays as f32, widest * mean)
    }
}

/// Features of a rim: means over the open rays. Contrasts are those of a sharp edge, relative to the minimum
/// of an edge point, and limited.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RimFeatures {
    /// Share of the rays that are open.
    pub open: f32,
    /// Contrast at the ellipse, and its common part with that of the ray a 16th of the circle away.
    pub contrast: f32,
    pub common: f32,
    /// Contrast 2 px inside and outside, and 4 px inside.
    pub near_in: f32,
    pub near_out: f32,
    pub far_in: f32,
    /// Contrast within 1 px, over the sum within 3 px.
    pub sharp: f32,
    /// Brightening outwards: 2 px inside, at the ellipse, and 2 to 3 px outside.
    pub shade_in: f32,
    pub shade: f32,
    pub shade_out: f32,
    /// Distance of the strongest edge from the ellipse; 2 without one within 2 px [px].
    pub jitter: f32,
    /// Longest share of the rim without an edge within 1 px, cut at the first ray.
    pub gap: f32,
}

impl RimFeatures {
    /// Adds the contrasts of a ray; returns the distance of its edge from the ellipse.
    fn add(&mut self, signed: &[f32; PLACES]) -> f32 {
        const MIDDLE: usize = MAX_HALF;
        let sizes = signed.map(math::abs);
        let here = math::max(math::max(sizes[MIDDLE], sizes[MIDDLE - 1]), sizes[MIDDLE + 1]);
        let width: f32 = sizes[MIDDLE - 3..=MIDDLE + 3].iter().sum();
        self.contrast += math::min(sizes[MIDDLE], 4.0);
        self.near_in += math::min(sizes[MIDDLE - 2], 4.0);
        self.near_out += math::min(sizes[MIDDLE + 2], 4.0);
        self.far_in += math::min(sizes[MIDDLE - 4], 4.0);
        self.sharp += here / (width + 1.0);
        self.shade_in += math::clamp(signed[MIDDLE - 2], -2.0, 2.0);
        self.shade += math::clamp(signed[MIDDLE], -2.0, 2.0);
        self.shade_out += math::clamp(signed[MIDDLE + 2] + signed[MIDDLE + 3], -2.0, 2.0);
        let mut best = MIDDLE;
        for index in MIDDLE - 2..=MIDDLE + 2 {
            if sizes[index] > sizes[best] {
                best = index;
            }
        }
        let offset = best as f32 - MIDDLE as f32 + peak([sizes[best - 1], sizes[best], sizes[best + 1]]);
        let offset = if sizes[best] < 1.0 { 2.0 } else { math::min(math::abs(offset), 2.0) };
        self.jitter += offset;
        offset
    }

    /// Computes the means from the sums over open rays.
    fn means(&self, mean: f32, open: f32, gap: f32) -> Self {
        Self {
            open,
            contrast: mean * self.contrast,
            common: mean * self.common,
            near_in: mean * self.near_in,
            near_out: mean * self.near_out,
            far_in: mean * self.far_in,
            sharp: mean * self.sharp,
            shade_in: mean * self.shade_in,
            shade: mean * self.shade,
            shade_out: mean * self.shade_out,
            jitter: mean * self.jitter,
            gap,
        }
    }
}

/// Common part of two contrasts: the smaller magnitude if the signs agree, limited to 3, over 3.
fn common(one: f32, other: f32) -> f32 {
    let [one, other] = [one, other].map(|contrast| math::clamp(contrast, -3.0, 3.0));
    (math::abs(one + other) - math::abs(one - other)) * (1.0 / 6.0)
}

/// Offset from the middle of the maximum of a parabola through three heights.
fn peak([before, here, after]: [f32; 3]) -> f32 {
    let curvature = before + after - 2.0 * here;
    if curvature < 0.0 { math::clamp(0.5 * (before - after) / curvature, -0.5, 0.5) } else { 0.0 }
}

/// Whether the end of a knob hides a point or has its own rim there.
pub(super) fn hides(front: &Ellipse, point: [f32; 2]) -> bool {
    front.distance_to(point) < 0.03 * front.radius + 1.5
}

/// Samples the grey levels along a ray, from two steps before the first contrast to two after the last one,
/// in 16ths. Returns `false` if that leaves the image.
fn sample(
    image: &Image<'_>,
    ellipse: &Ellipse,
    (direction, polar_radius): ([f32; 2], f32),
    (half, unit): (usize, f32),
    greys: &mut [i32; PLACES + 4],
) -> bool {
    let side = (half + 2) as f32 * unit;
    let ends = [-side, side].map(|side| ellipse.point(direction, polar_radius + side));
    if ends.iter().any(|[x, y]| !image.contains(*x, *y, 0.01)) {
        return false;
    }
    let [mut x, mut y] = ends[0].map(Image::fixed);
    let [dx, dy] = direction.map(|component| Image::fixed(unit * component));
    for grey in greys.get_mut(..2 * half + 5).unwrap_or_default() {
        *grey = image.at(x, y) >> 12;
        x += dx;
        y += dy;
    }
    true
}
