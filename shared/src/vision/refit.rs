use super::ellipse::Ellipse;
use super::image::Image;
use super::starts::{MAX_CANDIDATES, Start};
use crate::math;

/// Rays from the centre.
pub(super) const RAYS: usize = 64;
/// Cosine and sine of the angle between two rays.
const TURN: [f32; 2] = [0.995_184_7, 0.098_017_14];
/// Neighbouring rays that are judged together.
const GROUP: usize = 4;
/// Most samples of a ray to each side of the ellipse, without the margin of the derivative.
const MAX_BAND: usize = 8;
/// Samples along a ray.
const SAMPLES: usize = 2 * MAX_BAND + 5;
/// Distance between the three parallel profiles of a ray [px].
const ACROSS: f32 = 1.5;
/// What is free around a profile, with the rounding of its places [px].
const MARGIN: f32 = ACROSS + 0.01;
/// Standard deviation of the derivative along a ray, over that of the pixels.
const DERIVATIVE_NOISE: f32 = 0.5;
/// Contrast of an edge with a blur of 1 px that steps of half a pixel see, over that of whole steps.
const HALF_STEPS: f32 = 0.6;
/// Least contrast of an edge point [grey levels].
const MIN_CONTRAST: f32 = 4.0;
/// A flattening that halves the strength of the evidence: that of a circle seen at 25°.
const FLATTENING: f32 = 0.1;
/// Number of open rays that is as good as all.
const MANY_RAYS: f32 = 40.0;
/// Open rays, of every second, without which a circle gets no glance.
const FEWEST_RAYS: u8 = 10;
/// Candidates that are as near to each other after the first step lead to the same rim [px].
const SAME_START: f32 = 0.8;
/// Bounds of the residual in Tukey's weights, fit by fit, over the band that was searched.
const TUKEY: [f32; 4] = [1.0, 0.75, 0.5, 0.4];

/// A fitted ellipse with its evidence.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fit {
    pub ellipse: Ellipse,
    /// Rays inside the image, a bit for each.
    pub visible: u64,
    /// Rays that end on the knob before the circle.
    pub hidden: u64,
    /// Rays with an edge point on the ellipse.
    pub inliers: u64,
    /// Rays of groups with a common edge on the ellipse.
    pub coherent: u64,
}

impl Fit {
    /// Rays on which a rim is expected.
    pub const fn open(&self) -> u64 {
        self.visible & !self.hidden
    }

    /// Strength of the evidence for the circle, 0 to 1: share of the open rays with an edge on it. Any edges
    /// fit a short arc; a flat ellipse is less likely.
    pub fn evidence(&self) -> f32 {
        let [p, q] = self.ellipse.flattening;
        let open = self.open();
        let found = (self.inliers & open).count_ones() + (self.coherent & open).count_ones();
        let count = open.count_ones() as f32;
        let share = 0.5 * found as f32 / math::clamp(count, 1.0, RAYS as f32);
        let flat = 1.0 + (p * p + q * q) * (1.0 / (FLATTENING * FLATTENING));
        share / flat * math::clamp(count / MANY_RAYS, 0.0, 1.0)
    }

    /// Rays whose point on the ellipse is hidden by `front`.
    pub fn hidden_by(&self, front: &Ellipse) -> u64 {
        let point = |[u, v]: [f32; 2]| {
            let reach = self.ellipse.reach([u, v]);
            [self.ellipse.center[0] + reach * u, self.ellipse.center[1] + reach * v]
        };
        (0..)
            .zip(directions())
            .fold(0, |mask, (ray, direction)| mask | u64::from(hides(front, point(direction))) << ray)
    }

    /// How far apart two circles are [px].
    pub fn distance(&self, other: &Self) -> f32 {
        self.ellipse.distance(&other.ellipse)
    }
}

/// Whether the end of a knob hides a point, or has its own rim there.
fn hides(front: &Ellipse, point: [f32; 2]) -> bool {
    distance(front, point) < 0.03 * front.radius + 1.5
}

/// How well an edge follows the part of a circle that `front` leaves open, 0 to 1: on every second ray, the
/// contrast that neighbours have in common, up to three times the least of an edge point. A glance, to choose
/// what is fitted.
pub(super) fn glance(image: &Image<'_>, circle: &Ellipse, front: &Ellipse, noise: f32) -> f32 {
    let most = 3.0 * least_contrast(noise);
    let (mut open, mut sum, mut before) = (0_u8, 0.0, 0.0);
    for [u, v] in directions().step_by(2) {
        let at = |reach: f32| [circle.center[0] + reach * u, circle.center[1] + reach * v];
        let point = at(circle.radius);
        let mut here = 0.0;
        if image.contains(point[0], point[1], 2.0 * ACROSS) && !hides(front, point) {
            let [inner, outer] = [-ACROSS, ACROSS].map(|offset| {
                let [x, y] = at(circle.radius + offset).map(Image::fixed);
                image.at(x, y)
            });
            here = math::clamp((outer - inner) as f32 * (1.0 / 65536.0), -most, most);
            open += 1;
        }
        sum += 0.5 * (math::abs(here + before) - math::abs(here - before));
        before = here;
    }
    if open < FEWEST_RAYS { 0.0 } else { sum / (most * f32::from(open.max(MANY_RAYS as u8 / 2))) }
}

/// Deviation of the noise [grey levels]: mean absolute value of a difference that is blind to slopes
/// (Immerkær 1996), at every fourth pixel in both directions.
pub(super) fn noise(image: &Image<'_>) -> f32 {
    let (mut sum, mut count) = (0, 0);
    for y in (1..image.height() - 1).step_by(4) {
        let [above, here, below] = [y - 1, y, y + 1].map(|y| image.row(y));
        let triples = above.windows(3).zip(here.windows(3)).zip(below.windows(3)).step_by(4);
        for ((above, here), below) in triples {
            if let (&[a, b, c], &[d, e, f], &[g, h, i]) = (above, here, below) {
                let [a, b, c, d, e, f, g, h, i] = [a, b, c, d, e, f, g, h, i].map(i32::from);
                let value = a + c + g + i - 2 * (b + d + f + h) + 4 * e;
                // Edges do not count as noise.
                sum += value.abs().min(80);
                count += 1;
            }
        }
    }
    // √(π/2)/6
    0.208_9 * sum as f32 / count.max(1) as f32
}

/// Grey levels along a ray, from inside to outside.
struct Profile {
    length: usize,
    /// Distance of the samples, where it is less than a pixel [px].
    unit: f32,
    grey: [f32; SAMPLES],
    /// Differences of the parallel profiles.
    across: [f32; SAMPLES],
}

impl Profile {
    /// Samples `band` + 2 steps of `unit` px to both sides of the ellipse; None if that leaves the image.
    fn new(
        image: &Image<'_>,
        ellipse: &Ellipse,
        direction: [f32; 2],
        band: usize,
        unit: f32,
    ) -> Option<Self> {
        let [u, v] = direction;
        let half = band.min(MAX_BAND) + 2;
        let (reach, side) = (ellipse.reach(direction), half as f32 * unit);
        let [cx, cy] = ellipse.center;
        let is_inside = |reach: f32| image.contains(cx + reach * u, cy + reach * v, MARGIN);
        if !is_inside(reach + side) || !is_inside(reach - side) {
            return None;
        }
        let mut profile =
            Self { length: 2 * half + 1, unit: unit.min(1.0), grey: [0.0; SAMPLES], across: [0.0; SAMPLES] };
        let [mut x, mut y] = [cx + (reach - side) * u, cy + (reach - side) * v].map(Image::fixed);
        let [dx, dy, along_x, along_y] = [-ACROSS * v, ACROSS * u, unit * u, unit * v].map(Image::fixed);
        for (grey, across) in profile.grey.iter_mut().zip(&mut profile.across).take(profile.length) {
            let (left, right) = (image.at(x - dx, y - dy), image.at(x + dx, y + dy));
            *grey = (left + image.at(x, y) + right) as f32 * (1.0 / (3.0 * 65536.0));
            *across = (right - left) as f32 * (1.0 / 65536.0);
            x += along_x;
            y += along_y;
        }
        Some(profile)
    }

    /// Smoothed derivative: the contrast of a sharp edge there [grey levels].
    #[inline]
    fn contrast(&self, index: usize) -> f32 {
        match self.grey.get(index.wrapping_sub(2)..index + 3) {
            Some(&[a, b, _, d, e]) => (2.0 * (d - b) + (e - a)) * (1.0 / 3.0),
            _ => 0.0,
        }
    }

    /// Offset from the ellipse, in steps, of the strongest edge with a gradient along the ray.
    fn edge(&self, least: f32) -> Option<f32> {
        let middle = self.length / 2;
        let (mut best, mut at) = (0.0, 0);
        let falloff = 0.5 / ((middle - 1) * (middle - 1)) as f32;
        for index in 2..self.length - 2 {
            let away = index as f32 - middle as f32;
            let score = math::abs(self.contrast(index)) * (1.0 - falloff * away * away);
            if score > best {
                (best, at) = (score, index);
            }
        }
        let contrast = math::abs(self.contrast(at));
        let least = if self.unit < 1.0 { HALF_STEPS * least } else { least };
        if contrast < least || at < 3 || at + 4 > self.length {
            return None;
        }
        // A slope of 1 is a contrast of 8/3 along, and of 2 · 1.5 across.
        let across = self.across[at - 1] + self.across[at] + self.across[at + 1];
        if math::abs(across) * (8.0 / 27.0) * self.unit > 0.6 * contrast + 0.3 * least {
            return None;
        }
        let (before, after) = (math::abs(self.contrast(at - 1)), math::abs(self.contrast(at + 1)));
        let curvature = before + after - 2.0 * contrast;
        let shift = if curvature < 0.0 { 0.5 * (before - after) / curvature } else { 0.0 };
        Some(at as f32 - middle as f32 + math::clamp(shift, -0.5, 0.5))
    }
}

/// Directions of the rays.
fn directions() -> impl Iterator<Item = [f32; 2]> {
    let [cos, sin] = TURN;
    core::iter::successors(Some([1.0, 0.0]), move |[u, v]: &[f32; 2]| {
        Some([u * cos - v * sin, u * sin + v * cos])
    })
    .take(RAYS)
}

/// A picture in which rims are looked for; where `front` hides them, no edge counts.
pub(super) struct Rims<'a> {
    pub image: &'a Image<'a>,
    pub noise: f32,
    pub front: Option<&'a Ellipse>,
}

impl Rims<'_> {
    /// Fits to each of the candidates, the best first, an ellipse. Where several lead to one rim, the first
    /// of them.
    pub fn fit_all<'a>(
        &'a self,
        starts: &'a [Option<Start>; MAX_CANDIDATES],
    ) -> impl Iterator<Item = Fit> + 'a {
        let mut known = [None::<Ellipse>; MAX_CANDIDATES];
        starts.iter().flatten().zip(0..).filter_map(move |(start, index)| {
            let near = self.approach(&start.ellipse, start.band())?;
            let is_known = |other: &Ellipse| other.distance(&near) < SAME_START;
            if known.iter().flatten().any(is_known) {
                return None;
            }
            *known.get_mut(index)? = Some(near);
            self.fit(&near, start.band().1)
        })
    }

    /// A first step from a candidate towards the edge within `band` steps of `unit` px: a circle, as a
    /// mixture of two rims would be a fine ellipse.
    fn approach(&self, start: &Ellipse, (band, unit): (usize, f32)) -> Option<Ellipse> {
        self.step(start, (band, unit), 2, 0.003)
    }

    /// Fits an ellipse to the edge nearer and nearer to a first step of `unit` px. Returns None without a
    /// common ellipse.
    fn fit(&self, near: &Ellipse, unit: f32) -> Option<Fit> {
        let middle = math::clamp(0.5 * unit, 1.0, unit);
        let ellipse = self.step(near, (4, middle), 1, 0.006)?;
        let ellipse = self.step(&ellipse, (2, 1.0), 1, 0.02)?;
        // At last in steps of half a pixel, so that the shadow beside the rim counts less.
        let ellipse = self.step(&ellipse, (3, 0.5), 1, 0.02)?;
        judge(self.image, &ellipse, self.noise, self.front)
    }

    /// [`Rims::approach`] and [`Rims::fit`].
    pub fn refit(&self, start: &Ellipse, (band, unit): (usize, f32)) -> Option<Fit> {
        self.fit(&self.approach(start, (band, unit))?, unit)
    }

    fn step(
        &self,
        ellipse: &Ellipse,
        (band, unit): (usize, f32),
        every: usize,
        flattening: f32,
    ) -> Option<Ellipse> {
        let seen = edge_points(self.image, ellipse, (band, unit), every, self.noise, self.front)?;
        approach(ellipse, &seen, unit * band as f32, flattening)
    }
}

/// Least contrast of an edge point.
fn least_contrast(noise: f32) -> f32 {
    math::clamp(1.5 * DERIVATIVE_NOISE * noise, MIN_CONTRAST, 255.0)
}

/// Edge points (x, y) next to an ellipse, along every `step`-th ray, with weights 0 or 1. None if they are
/// few.
fn edge_points(
    image: &Image<'_>,
    ellipse: &Ellipse,
    (band, unit): (usize, f32),
    step: usize,
    noise: f32,
    front: Option<&Ellipse>,
) -> Option<[([f32; 2], f32); RAYS]> {
    let mut points = [([0.0; 2], 0.0); RAYS];
    let least = least_contrast(noise);
    let mut count = 0;
    for (direction, (point, weight)) in directions().zip(&mut points).step_by(step) {
        let Some(profile) = Profile::new(image, ellipse, direction, band, unit) else { continue };
        if let Some(offset) = profile.edge(least) {
            // The parallel profiles meet the rim nearer to the centre.
            let reach = ellipse.reach(direction) + offset * unit;
            let reach = reach + ACROSS * ACROSS / (3.0 * reach);
            *point = [ellipse.center[0] + reach * direction[0], ellipse.center[1] + reach * direction[1]];
            if !front.is_some_and(|front| hides(front, *point)) {
                *weight = 1.0;
                count += 1;
            }
        }
    }
    (count >= RAYS / (5 * step)).then_some(points)
}

/// The robust fit to edge points within `band` px; the expected deviation of the flattening.
fn approach(
    start: &Ellipse,
    points: &[([f32; 2], f32); RAYS],
    band: f32,
    flattening: f32,
) -> Option<Ellipse> {
    let mut ellipse = *start;
    for bound in TUKEY {
        let bound = bound * band;
        let weighted = points.iter().map(|&(point, weight)| {
            let ratio = distance(&ellipse, point) / bound;
            let tukey = if ratio * ratio < 1.0 { (1.0 - ratio * ratio) * (1.0 - ratio * ratio) } else { 0.0 };
            (point, weight * tukey)
        });
        ellipse = ellipse.refit(weighted, flattening)?;
    }
    Some(ellipse)
}

/// Distance of a point from the ellipse, outwards from the centre, to first order in it and in the squared
/// flattening [px].
fn distance(ellipse: &Ellipse, [x, y]: [f32; 2]) -> f32 {
    let (u, v) = (x - ellipse.center[0], y - ellipse.center[1]);
    let [p, q] = ellipse.flattening;
    let square = (u * u + v * v + p * (u * u - v * v) + 2.0 * q * u * v) * (1.0 + 0.5 * (p * p + q * q));
    0.5 * (square / ellipse.radius - ellipse.radius)
}

/// The evidence for an ellipse.
fn judge(image: &Image<'_>, ellipse: &Ellipse, noise: f32, front: Option<&Ellipse>) -> Option<Fit> {
    let mut fit = Fit { ellipse: *ellipse, visible: 0, hidden: 0, inliers: 0, coherent: 0 };
    let (mut sum, mut count) = ([0.0_f32; 3], 0.0_f32);
    let least = least_contrast(noise);
    for (ray, direction) in directions().enumerate() {
        if let Some(profile) = Profile::new(image, ellipse, direction, 3, 1.0) {
            fit.visible |= 1 << ray;
            count += 1.0;
            let middle = profile.length / 2;
            for (sum, index) in sum.iter_mut().zip([middle - 3, middle, middle + 3]) {
                *sum += profile.contrast(index);
            }
            let is_inlier = profile.edge(least).is_some_and(|offset| math::abs(offset) < 1.0);
            fit.inliers |= u64::from(is_inlier) << ray;
        }
        if ray % GROUP == GROUP - 1 {
            let [inside, here, outside] = sum.map(math::abs);
            let limit = 3.0 * DERIVATIVE_NOISE * noise * math::sqrt(count);
            if count > 0.0 && here > limit && here > 2.5 * count && here > inside && here > outside {
                fit.coherent |= ((1 << GROUP) - 1) << (ray + 1 - GROUP);
            }
            (sum, count) = ([0.0; 3], 0.0);
        }
    }
    fit.coherent &= fit.visible;
    fit.hidden = front.map_or(0, |front| fit.hidden_by(front));
    (fit.inliers != 0).then_some(fit)
}
