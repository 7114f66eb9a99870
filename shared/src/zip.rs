//! Loops over three and more lists without nested pairs.

/// A tuple of three or more iterators that advance together.
pub(crate) trait Zip {
    /// A tuple with an item of each iterator.
    type Item;

    /// Ends with the shortest of the iterators.
    fn zip(self) -> impl Iterator<Item = Self::Item>;
}

/// Iterates over several lists at once, up to the end of the shortest:
/// `for (force, normal, radius) in zip((&forces, &normals, &radii))`.
pub(crate) fn zip<T: Zip>(values: T) -> impl Iterator<Item = T::Item> {
    values.zip()
}

macro_rules! zip_tuples {
    ($(($a:ident $b:ident $($rest:ident)*): $pattern:pat => $items:expr;)*) => {
        $(
            impl<$a: IntoIterator, $b: IntoIterator, $($rest: IntoIterator),*> Zip for ($a, $b, $($rest),*) {
                type Item = ($a::Item, $b::Item, $($rest::Item),*);

                #[inline]
                fn zip(self) -> impl Iterator<Item = Self::Item> {
                    #[allow(non_snake_case, reason = "values are named after their types")]
                    let ($a, $b, $($rest),*) = self;
                    let nested = $a.into_iter().zip($b)$(.zip($rest))*;
                    nested.map(|$pattern| $items)
                }
            }
        )*
    };
}

zip_tuples! {
    (A B C): ((a, b), c) => (a, b, c);
    (A B C D): (((a, b), c), d) => (a, b, c, d);
    (A B C D E): ((((a, b), c), d), e) => (a, b, c, d, e);
}
