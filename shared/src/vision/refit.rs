use super::ellipse::{DEVIATION, Ellipse};
use super::image::Image;
use super::offset::{Context, INPUTS, Profiles};
use super::ring::{FEW_RAYS, MAX_HALF, RAYS, Ring};
use super::starts::{MAX_CANDIDATES, Start};
use crate::math;

/// Candidates this near to each other after the first step lead to the same rim [px].
const SAME_START: f32 = 0.8;
/// Number of reweighted fits.
const FITS: usize = 3;
/// Bounds of the residual in Tukey's weights for each fit, relative to the band of the start.
const TUKEY: [f32; FITS] = [1.0, 0.6, 0.4];
/// The same for the refinement, outside the ellipse [px], and ratio of the bounds inside to those.
const FINE_BOUNDS: [f32; FITS] = [0.8, 0.6, 0.6];
const INSIDE: f32 = 3.0;
/// Minimum bound outside, relative to the mean distance of the edge points.
const SCATTER: f32 = 2.0;

/// Radius up to which the network refines an ellipse [px]: beyond that of its pictures it would extrapolate.
const MAX_REFINED: f32 = 80.0;
/// Fewest rays on which it must see the rim, and largest change of centre and radius [px]: it was fitted to
/// pictures within these limits.
const MIN_REFINED: u32 = 8;
const MAX_CHANGE: f32 = 4.0;
/// Prior standard deviation of the change of the flattening in that fit.
const FLATTENING_CHANGE: f32 = 0.03;

/// Standard deviation of the noise [grey levels]: from the mean absolute value of a difference operator that
/// is insensitive to slopes (Immerkær 1996), at every fourth pixel in both directions.
pub(super) fn noise(image: &Image<'_>) -> f32 {
    let (mut sum, mut count) = (0, 0);
    for y in (1..image.height() - 1).step_by(4) {
        let [above, here, below] = [y - 1, y, y + 1].map(|y| image.row(y));
        let triples = above.windows(3).zip(here.windows(3)).zip(below.windows(3)).step_by(4);
        for ((above, here), below) in triples {
            if let (&[a, b, c], &[d, e, f], &[g, h, i]) = (above, here, below) {
                let [a, b, c, d, e, f, g, h, i] = [a, b, c, d, e, f, g, h, i].map(i32::from);
                let value = a + c + g + i - 2 * (b + d + f + h) + 4 * e;
                // Limited, so that edges do not count as noise.
                sum += value.abs().min(80);
                count += 1;
            }
        }
    }
    // √(π/2)/6
    0.208_9 * sum as f32 / count.max(1) as f32
}

/// An image in which rims are searched. Edges that `front` hides are ignored.
pub(super) struct Rims<'a> {
    pub image: &'a Image<'a>,
    pub noise: f32,
    pub front: Option<&'a Ellipse>,
}

impl Rims<'_> {
    /// Fits an ellipse to each candidate, the best first. If several lead to the same rim, only the first is
    /// returned.
    pub fn fit_all<'a>(
        &'a self,
        starts: &'a [Option<Start>; MAX_CANDIDATES],
    ) -> impl Iterator<Item = Ellipse> + 'a {
        let mut known = [None::<Ellipse>; MAX_CANDIDATES];
        starts.iter().flatten().zip(0..).filter_map(move |(start, index)| {
            // The first step fits a circle: an ellipse could fit a mixture of two rims.
            let (band, unit) = start.band();
            let near = self.step(&start.ellipse, (band, unit), FEW_RAYS, 0.003)?;
            let is_known = |other: &Ellipse| other.distance(&near) < SAME_START;
            if known.iter().flatten().any(is_known) {
                return None;
            }
            *known.get_mut(index)? = Some(near);
            self.step(&near, (3, math::clamp(0.4 * unit, 1.0, unit)), FEW_RAYS, 0.02)
        })
    }

    /// Fits to the edge next to an ellipse, on all rays.
    pub fn closer(&self, ellipse: &Ellipse) -> Option<Ellipse> {
        self.step(ellipse, (2, 1.0), RAYS, 0.02)
    }

    /// Fits to the rim near an ellipse, where the network of [`offset`](super::offset) sees it. `None` if it
    /// sees too little of it, or places it farther away than it can see.
    pub fn refine(&self, ellipse: &Ellipse) -> Option<Ellipse> {
        if ellipse.radius > MAX_REFINED {
            return None;
        }
        let profiles = Profiles::new(self.image, ellipse, self.front);
        if profiles.count() < MIN_REFINED { None } else { refined(ellipse, profiles.rays()) }
    }

    /// Fits to the edge next to an ellipse in steps of half a pixel. A shadow beside the rim displaces the
    /// edge outwards, so edge points outside the ellipse have tighter bounds than those inside.
    pub fn closest(&self, ellipse: &Ellipse) -> Option<Ellipse> {
        let ring = Ring::new(self.image, ellipse, RAYS, (MAX_HALF, 0.5));
        let points = ring.edge_points(self.noise, self.front)?;
        // In a noisy image the edge points have more scatter.
        let (mut sum, mut count) = (0.0, 0.0);
        for (point, weight) in &points {
            sum += weight * math::min(math::abs(ellipse.distance_to(*point)), 2.0);
            count += weight;
        }
        let scatter = SCATTER * sum / count;
        fit(ellipse, &points, FINE_BOUNDS.map(|bound| [INSIDE * bound, bound.max(scatter)]), 0.02)
    }

    /// Fits an ellipse to the edge within `band` steps of `unit` px.
    fn step(
        &self,
        ellipse: &Ellipse,
        (band, unit): (usize, f32),
        rays: usize,
        flattening: f32,
    ) -> Option<Ellipse> {
        let ring = Ring::new(self.image, ellipse, rays, (band, unit));
        let points = ring.edge_points(self.noise, self.front)?;
        let band = unit * band as f32;
        fit(ellipse, points.get(..rays)?, TUKEY.map(|bound| [bound * band; 2]), flattening)
    }
}

/// Fits an ellipse to the rim near another one, from the directions of rays and the network's inputs on each.
pub(super) fn refined(
    near: &Ellipse,
    rays: impl Iterator<Item = ([f32; 2], [f32; INPUTS])> + Clone,
) -> Option<Ellipse> {
    let (context, root) = (Context::new(rays.clone()), near.root());
    let points = rays.map(|(direction, inputs)| {
        let (offset, weight) = context.offset(direction, &inputs);
        let polar_radius = near.polar_radius(root, direction) + offset;
        (near.point(direction, polar_radius), weight * DEVIATION * DEVIATION)
    });
    let refined = near.refit(points, (near.flattening, FLATTENING_CHANGE))?;
    refined.is_near(near, [MAX_CHANGE; 2]).then_some(refined)
}

/// Robust fit to edge points with Tukey's weights. `bounds`: of the residual inside and outside for each fit
/// [px]; `flattening`: its prior standard deviation.
fn fit(
    start: &Ellipse,
    points: &[([f32; 2], f32)],
    bounds: [[f32; 2]; FITS],
    flattening: f32,
) -> Option<Ellipse> {
    let mut ellipse = *start;
    for [inside, outside] in bounds {
        let weighted = points.iter().map(|&(point, weight)| {
            let distance = ellipse.distance_to(point);
            let ratio = distance / if distance < 0.0 { inside } else { outside };
            let tukey = if ratio * ratio < 1.0 { (1.0 - ratio * ratio) * (1.0 - ratio * ratio) } else { 0.0 };
            (point, weight * tukey)
        });
        ellipse = ellipse.refit(weighted, ([0.0; 2], flattening))?;
    }
    Some(ellipse)
}
