//! Lists that cannot panic.

use heapless::Vec;

/// The first `N` items. Collecting into a `Vec` panics when there are more, which the compiler cannot always
/// exclude.
#[inline]
pub(crate) fn collect<T, const N: usize>(items: impl IntoIterator<Item = T>) -> Vec<T, N> {
    let mut list = Vec::new();
    for item in items {
        if list.push(item).is_err() {
            break;
        }
    }
    list
}
