//! Time series as CSV.

use std::borrow::Cow;

use ::csv::Writer;

/// One column of a table of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Column<'a> {
    /// Its name, for example `finger1_base reference`.
    pub name: String,
    /// Its unit; empty for counts and ratios.
    pub unit: String,
    /// The values, one per row.
    pub values: Cow<'a, [f64]>,
}

impl<'a> Column<'a> {
    /// Creates a column of `values` in `unit`.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, values: impl Into<Cow<'a, [f64]>>) -> Self {
        Self { name: name.into(), unit: unit.into(), values: values.into() }
    }
}

/// A table with a row for each item of a list.
#[derive(Clone, Debug)]
pub struct Table<'a, T> {
    items: &'a [T],
    columns: Vec<Column<'static>>,
}

impl<'a, T> Table<'a, T> {
    /// Creates a table without columns.
    pub const fn new(items: &'a [T]) -> Self {
        Self { items, columns: Vec::new() }
    }

    /// Adds a column: a value of each item in `unit`.
    pub fn column(
        &mut self,
        name: impl Into<String>,
        unit: impl Into<String>,
        value: impl Fn(&T) -> f64,
    ) -> &mut Self {
        let values: Vec<f64> = self.items.iter().map(value).collect();
        self.columns.push(Column::new(name, unit, values));
        self
    }

    /// Formats the table, see [`csv()`].
    pub fn csv(&self) -> String {
        csv(&self.columns)
    }
}

/// Formats the columns as CSV: a header `name [unit]`, then one row per sample, with fields quoted according
/// to RFC 4180 and lines ended by a newline.
///
/// Numbers have the shortest form that reads back as the same `f64`. If a column is shorter than the longest,
/// its remaining fields are empty; non-finite values are `NaN`, `inf` or `-inf`.
pub fn csv(columns: &[Column<'_>]) -> String {
    let mut writer = Writer::from_writer(Vec::new());
    let header = columns.iter().map(|column| match column.unit.as_str() {
        "" => column.name.clone(),
        unit => format!("{} [{unit}]", column.name),
    });
    // All rows have the same length, and the output is in memory, so nothing here can fail.
    writer.write_record(header).expect("a header can be written to memory");
    let rows = columns.iter().map(|column| column.values.len()).max().unwrap_or(0);
    for row in 0..rows {
        let fields = columns
            .iter()
            .map(|column| column.values.get(row).map_or_else(String::new, |value| format!("{value:?}")));
        writer.write_record(fields).expect("a row as long as the header can be written to memory");
    }
    let bytes = writer.into_inner().expect("memory can be flushed");
    String::from_utf8(bytes).expect("names and numbers are UTF-8")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_units_and_lengths() {
        let text = csv(&[
            Column::new("time", "s", &[0.0, 0.01, 0.1 + 0.2]),
            Column::new("tip \"x\", hand", "mm", &[1e-9, f64::NAN]),
            Column::new("tick", "", &[1.0, 2.0, 3.0]),
        ]);
        let expected = "time [s],\"tip \"\"x\"\", hand [mm]\",tick\n\
                        0.0,1e-9,1.0\n\
                        0.01,NaN,2.0\n\
                        0.30000000000000004,,3.0\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn a_table_has_a_row_for_each_item() {
        let mut table = Table::new(&[2, 3]);
        table
            .column("side", "m", |side| f64::from(*side))
            .column("area", "m²", |side| f64::from(side * side));
        assert_eq!(table.csv(), "side [m],area [m²]\n2.0,4.0\n3.0,9.0\n");
    }
}
