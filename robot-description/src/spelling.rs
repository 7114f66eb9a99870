//! Names that are nearly known ones.

/// The known name that an unknown one was meant to be, if it is a matter of a few letters.
///
/// ```
/// use tesaki_description::spelling::meant;
/// assert_eq!(meant("clucth", &["elbow", "clutch"]), Some("clutch"));
/// assert_eq!(meant("clutch", &["elbow", "clutch"]), None);
/// ```
pub fn meant<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let distance = |known: &str| strsim::osa_distance(name, known);
    let nearest = known.iter().copied().min_by_key(|known| distance(known))?;
    (1..=(nearest.len() / 3).max(1)).contains(&distance(nearest)).then_some(nearest)
}
