/// Random angles from which a search starts, the same in every search: the linear congruential generator of
/// Numerical Recipes, whose upper 24 bits suffice.
pub(super) struct RandomStarts(u32);

impl RandomStarts {
    pub(super) const fn new() -> Self {
        Self(1)
    }

    /// The next angle, between two limits [rad].
    pub(super) fn angle(&mut self, (lower, upper): (f32, f32)) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        #[expect(clippy::cast_precision_loss, reason = "24 bits")]
        let fraction = (self.0 >> 8) as f32 / 16_777_216.0;
        lower + fraction * (upper - lower)
    }
}
