//! Anthropometry: infers the links of fingers without markers from the proportions of the hand.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::calibration::LinkPrior;
use super::calibration_error::CalibrationError;
use super::human_hand::{FingerLinks, FingerRotations, HUMAN_FINGERS, HumanFinger};
use crate::math::{self, Svd};

/// Joints and tip of a finger: the ends of its links.
type Points = [Vector3<f32>; 4];

/// Mean lengths [mm] of metacarpal and phalanges between the centres of the joints on radiographs of 66
/// adults (A. Buryanov, V. Kotiuk, *Proportions of hand segments*, Int. J. Morphol. 28(3), 2010, table I);
/// the last one includes the soft tissue of the tip. The thumb's metacarpal is its first link.
const BONES: [[f32; 4]; HUMAN_FINGERS] = [
    [0.0, 46.22, 31.57, 27.34],
    [68.12, 39.78, 22.38, 19.66],
    [64.60, 44.63, 26.33, 21.35],
    [58.00, 41.37, 25.65, 21.25],
    [53.69, 32.74, 18.11, 19.69],
];
/// Proximal ends of the metacarpals [mm], distal and radial of the wrist, and their splay in the flat hand
/// [°]. The paper does not give these; they are estimates that make the palm 56 mm wide between the outer
/// joints.
const METACARPALS: [[f32; 3]; HUMAN_FINGERS] =
    [[20.0, 25.0, 45.0], [25.0, 14.0, 9.0], [25.0, 3.0, 2.0], [25.0, -9.0, -6.0], [25.0, -19.0, -13.0]];
/// Standard deviation of the first joint from its position in the fitted hand, along each axis [m].
const JOINT_DEVIATION: f32 = 4e-3;
/// Standard deviation of a bone's length relative to the scaled mean hand: 5 to 8 %.
const RATIO_DEVIATION: f32 = 0.065;
/// Standard deviation of a link's end across the bone [m].
const ACROSS_DEVIATION: f32 = 1e-3;

/// Infers the links of all fingers from those that are calibrated by markers. The mean hand is scaled,
/// rotated and translated to fit the joints and tips of the calibrated fingers except the thumb in the flat
/// hand (least squares; Umeyama 1991). The orientations in the flat hand transform its bones to the frames of
/// the sensors.
///
/// `calibrated` and `flat`: thumb to little finger.
///
/// # Errors
/// Fewer than two calibrated fingers besides the thumb.
pub(super) fn infer_links(
    calibrated: &[Option<FingerLinks>; HUMAN_FINGERS],
    flat: &[FingerRotations; HUMAN_FINGERS],
) -> Result<[LinkPrior; HUMAN_FINGERS], CalibrationError> {
    let known = || {
        let fingers = HumanFinger::ALL.into_iter().zip(calibrated).zip(flat);
        fingers.filter_map(|((finger, links), flat)| match (finger, links) {
            (HumanFinger::Thumb, _) | (_, None) => None,
            (_, Some(links)) => Some((mean_points(finger), points(links, flat))),
        })
    };
    if known().count() < 2 {
        return Err(CalibrationError::TooFewFingers);
    }
    let pairs = || known().flat_map(|(mean, measured)| mean.into_iter().zip(measured));
    let (mut count, mut centres) = (0.0, [Vector3::zeros(); 2]);
    for (mean, measured) in pairs() {
        count += 1.0;
        centres = [centres[0] + mean, centres[1] + measured];
    }
    let centres = centres.map(|sum| sum / count);
    let (mut covariance, mut variance) = (SMatrix::<f32, 3, 3>::zeros(), 0.0);
    for (mean, measured) in pairs() {
        covariance += (measured - centres[1]) * (mean - centres[0]).transpose();
        variance += (mean - centres[0]).norm_squared();
    }
    let (turn, trace) = nearest_rotation(&covariance);
    let scale = trace / variance;
    let mut priors =
        [LinkPrior { mean: FingerLinks::default(), deviation: [JOINT_DEVIATION; 4] }; HUMAN_FINGERS];
    for ((prior, finger), flat) in priors.iter_mut().zip(HumanFinger::ALL).zip(flat) {
        let fitted = mean_points(finger).map(|point| centres[1] + turn * (point - centres[0]) * scale);
        prior.mean.0[0] = fitted[0].into();
        for (link, rotation) in flat.0.iter().enumerate() {
            let bone = fitted[link + 1] - fitted[link];
            prior.mean.0[link + 1] = (rotation.transpose() * bone).into();
            prior.deviation[link + 1] = ACROSS_DEVIATION + RATIO_DEVIATION * math::norm(&bone);
        }
    }
    Ok(priors)
}

/// Joints and tip of the mean flat hand [m]: x distal, y radial.
fn mean_points(finger: HumanFinger) -> Points {
    let [metacarpal, bones @ ..] = BONES[finger as usize];
    let [x, y, splay] = METACARPALS[finger as usize];
    let (sine, cosine) = math::sin_cos(splay.to_radians());
    let along = |length: f32| Vector3::new(x + cosine * length, y + sine * length, 0.0) * 1e-3;
    let mut length = metacarpal;
    let first = along(length);
    let [second, third, tip] = bones.map(|bone| {
        length += bone;
        along(length)
    });
    [first, second, third, tip]
}

/// Joints and tip of a calibrated finger [m].
fn points(links: &FingerLinks, rotations: &FingerRotations) -> Points {
    let [base, links @ ..] = links.0.map(Vector3::from);
    let mut end = base;
    let [first, second, third] = rotations.0;
    let [second, third, tip] =
        [(first, links[0]), (second, links[1]), (third, links[2])].map(|(rotation, link)| {
            end += rotation * link;
            end
        });
    [base, second, third, tip]
}

/// The rotation `Q` that maximises `tr(QᵀM)`, and that trace. Works for coplanar points, too.
fn nearest_rotation(matrix: &Matrix3<f32>) -> (Matrix3<f32>, f32) {
    let svd = Svd::new(matrix);
    let unit = |k: usize| svd.scaled.column(k) / svd.values[k].max(f32::MIN_POSITIVE);
    let [left_0, left_1] = [unit(0), unit(1)];
    let (right_0, right_1) = (svd.right.column(0), svd.right.column(1));
    let (left_2, right_2) = (left_0.cross(&left_1), right_0.cross(&right_1));
    let turn = left_0 * right_0.transpose() + left_1 * right_1.transpose() + left_2 * right_2.transpose();
    (turn, (turn.transpose() * matrix).trace())
}
