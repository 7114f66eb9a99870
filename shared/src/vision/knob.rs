//! Roses behind the end of a knob.

use super::ellipse::Ellipse;
use super::find::{CircleSearch, Window};
use super::image::Image;
use super::judge::Knob;
use super::ring::{directions, min_contrast};
use super::starts::{Start, Starts};
use crate::math;

/// Ratio of the true radii of a rose and its knob, minimum and maximum.
const ROSE_RADIUS: [f32; 2] = [1.05, 2.2];
/// Maximum length of a knob over the distance of the camera from its foot.
const MAX_LENGTH: f32 = 0.6;
/// Steps of the centre along the axis and of the radius: minimum [px], and share of the radius.
const CENTER_STEP: (f32, f32) = (1.75, 0.07);
const RADIUS_STEP: (f32, f32) = (1.25, 0.05);
/// Maximum distance of two fits to the same rim, over its radius.
const SAME_RIM: f32 = 0.12;
/// Minimum score, as a share of the score with the limited contrast on all rays.
const MIN_SCORE: f32 = 0.12;
/// Rays of a coarse check, and samples on each.
const POLAR_RAYS: usize = 32;
const POLAR_PLACES: usize = 64;
/// Minimum number of open rays for a coarse check, and the number that counts as full.
const FEWEST_RAYS: i32 = 10;
const MANY_RAYS: i32 = 20;
/// A sample outside the image.
const UNSEEN: i16 = i16::MIN;

/// Polar image about the centre of a knob's end: contrasts on rays from it.
struct Polar {
    center: [f32; 2],
    from: f32,
    unit: f32,
    /// Limit of the contrast.
    max: i32,
    /// Contrasts in sixteenths of a grey level.
    contrasts: [[i16; POLAR_PLACES]; POLAR_RAYS],
}

impl Polar {
    fn new(image: &Image<'_>, knob: &Ellipse, to: f32, noise: f32) -> Self {
        let from = 1.03 * knob.radius + 1.5;
        let unit = ((to - from) / (POLAR_PLACES - 1) as f32).max(1.0);
        let max = (3.0 * 16.0 * min_contrast(noise)) as i32;
        let mut polar =
            Self { center: knob.center, from, unit, max, contrasts: [[UNSEEN; POLAR_PLACES]; POLAR_RAYS] };
        let count = (((to - from) / unit) as usize + 2).min(POLAR_PLACES);
        for (&[u, v], row) in directions(POLAR_RAYS).iter().zip(&mut polar.contrasts) {
            let at = |distance: f32| [knob.center[0] + distance * u, knob.center[1] + distance * v];
            let [mut x, mut y] = at(from - 1.5).map(Image::fixed);
            let [dx, dy] = [unit * u, unit * v].map(Image::fixed);
            let [across, along] = [1.5 * u, 1.5 * v].map(|component| 2 * Image::fixed(component));
            let is_inside = |index: usize| {
                let [x, y] = at(from + index as f32 * unit);
                image.contains(x, y, 2.0)
            };
            // If both ends are inside the image, all samples are.
            let are_all_inside = is_inside(0) && is_inside(count - 1);
            for (index, place) in row.iter_mut().enumerate().take(count) {
                if are_all_inside || is_inside(index) {
                    let contrast = (image.at(x + across, y + along) - image.at(x, y)) >> 12;
                    *place = contrast.clamp(-max, max) as i16;
                }
                x += dx;
                y += dy;
            }
        }
        polar
    }

    /// Displacement of a circle about `center` along each ray.
    fn shifts(&self, center: [f32; 2]) -> [f32; POLAR_RAYS] {
        let [ox, oy] = [center[0] - self.center[0], center[1] - self.center[1]];
        let mut shifts = [0.0; POLAR_RAYS];
        for (shift, [u, v]) in shifts.iter_mut().zip(directions(POLAR_RAYS)) {
            *shift = ox * u + oy * v;
        }
        shifts
    }

    /// How well an edge follows the part of a circle that the knob does not hide, 0 to 1: the common contrast
    /// of neighbouring rays. `shifts` are the displacements by its centre, `away` is the distance of the
    /// centre.
    fn score(&self, shifts: &[f32; POLAR_RAYS], away: f32, radius: f32) -> f32 {
        let rest = radius * radius - away * away;
        let scale = 1.0 / self.unit;
        let places = shifts.map(|shift| {
            let square = rest + shift * shift;
            (shift + math::finite_sqrt(math::max(square, 0.0)) - self.from) * scale
        });
        let (mut open, mut sum, mut before) = (0, 0, 0);
        for (place, row) in places.iter().zip(&self.contrasts) {
            let mut here = 0;
            if *place >= 0.0
                && let Some(&contrast) = row.get((place + 0.5) as i32 as usize)
                && contrast != UNSEEN
            {
                here = i32::from(contrast);
                open += 1;
            }
            // Twice the smaller magnitude if both have the same sign.
            sum += (here + before).abs() - (here - before).abs();
            before = here;
        }
        if open < FEWEST_RAYS { 0.0 } else { 0.5 * sum as f32 / (self.max * open.max(MANY_RAYS)) as f32 }
    }
}

/// Finds roses behind the end of a knob by a coarse check for an edge. They are farther along the axis, and
/// therefore nearer to its vanishing point, in proportion to their depth.
pub(super) fn roses(
    image: &Image<'_>,
    search: &CircleSearch,
    axis: &Window,
    noise: f32,
    knob: &Ellipse,
) -> Starts {
    let mut starts = Starts::NONE;
    let [dx, dy] = [0, 1].map(|index| knob.center[index] - axis.center[index]);
    let length = math::sqrt(dx * dx + dy * dy).max(1.0);
    let [u, v] = [dx / length, dy / length];
    let max_away = math::clamp(1.2 * knob.radius, 0.0, MAX_LENGTH * (length + axis.reach));
    let polar =
        Polar::new(image, knob, (ROSE_RADIUS[1] * knob.radius).min(search.radius[1]) + max_away, noise);
    let mut away = 0.0;
    while away < max_away {
        // Depth of the knob's end over that of the rose.
        let depth = 1.0 - math::clamp(away / length, 0.0, MAX_LENGTH);
        let [from, to] = ROSE_RADIUS.map(|ratio| ratio * depth * knob.radius);
        // The axis is uncertain.
        let spread = 0.5 + axis.reach * (1.0 - depth);
        for aside in [-spread, 0.0, spread] {
            let center = [knob.center[0] - away * u - aside * v, knob.center[1] - away * v + aside * u];
            let is_far = |window: &Window| {
                (0..2).any(|axis| math::abs(center[axis] - window.center[axis]) > window.reach + 2.0)
            };
            if search.window.as_ref().is_some_and(is_far) {
                continue;
            }
            let shifts = polar.shifts(center);
            let distance = math::sqrt(away * away + aside * aside);
            let mut radius = from.max(0.9 * knob.radius).max(search.radius[0]);
            while radius <= math::min(to, search.radius[1]) {
                let score = polar.score(&shifts, distance, radius);
                if score > MIN_SCORE {
                    starts.insert(Start { ellipse: Ellipse::circle(center, radius), score, side: 1.0 });
                }
                radius += math::max(RADIUS_STEP.0, RADIUS_STEP.1 * radius);
            }
        }
        away += math::max(CENTER_STEP.0, CENTER_STEP.1 * knob.radius);
    }
    starts
}

/// Circles that the end of a knob may partly hide: not much smaller, and at another position.
pub(super) fn hidden(circles: &[Option<Knob>], knob: &Knob) -> Starts {
    let mut starts = Starts::NONE;
    let front = &knob.ellipse;
    for Knob { ellipse, rim } in circles.iter().flatten() {
        let is_elsewhere = front.distance(ellipse) > SAME_RIM * ellipse.radius;
        if front.radius < 1.1 * ellipse.radius && is_elsewhere {
            starts.insert(Start { ellipse: *ellipse, score: rim.common, side: 1.0 });
        }
    }
    starts
}
