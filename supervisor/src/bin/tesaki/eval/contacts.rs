//! The contacts and the load of every row.

use nalgebra::{Vector3, Vector6};
use tesaki::grasp::{Contact, GraspMap, GraspMapError, InvalidContact, MAX_CONTACTS};

use super::{Row, Table};
use crate::args::Grip;
use crate::failure::Failure;

/// The columns of a contact, each with its number behind it.
const PLACE: [&str; 3] = ["x", "y", "z"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const FRICTION: &str = "mu";
const LIMIT: &str = "max";

/// Where the numbers of a grasp are.
pub struct Columns<'a> {
    asked: &'a Grip,
    pub contacts: Vec<ContactColumns>,
    force: [usize; 3],
    moment: Option<[usize; 3]>,
    origin: Option<[usize; 3]>,
}

/// Where the numbers of one contact are.
pub struct ContactColumns {
    /// As the columns have it, from 1.
    pub number: usize,
    place: [usize; 3],
    normal: [usize; 3],
    friction: Option<usize>,
    limit: Option<usize>,
}

/// What one row asks for.
pub struct Grasp {
    pub map: GraspMap,
    /// About the map's origin [N; N·m].
    pub load: Vector6<f32>,
    /// The number of each contact.
    pub numbers: Vec<usize>,
}

impl<'a> Columns<'a> {
    pub fn find(table: &Table, asked: &'a Grip) -> Result<Self, Failure> {
        if let Some(header) = table.headers().iter().find(|header| beyond(header)) {
            let message = format!("column {header}: contacts have the numbers 1 to {MAX_CONTACTS}");
            return Err(table.error(1, &message));
        }
        let contacts = (1..=MAX_CONTACTS).filter(|&number| number <= 2 || mentioned(table, number));
        let contacts = contacts.map(|number| ContactColumns::find(table, asked, number));
        Ok(Self {
            asked,
            contacts: contacts.collect::<Result<_, _>>()?,
            force: all(table, ["fx", "fy", "fz"], "force that the contacts shall exert [N]")?,
            moment: all_or_none(table, ["mx", "my", "mz"], "moment of the load [N·m]: all three, or none")?,
            origin: all_or_none(table, ["ox", "oy", "oz"], "point of the moment [m]: all three, or none")?,
        })
    }

    /// Every column that is read.
    pub fn used(&self) -> impl Iterator<Item = usize> {
        let contacts = self.contacts.iter().flat_map(ContactColumns::all);
        contacts.chain(self.force).chain(self.moment.into_iter().chain(self.origin).flatten())
    }

    pub fn grasp(&self, table: &Table, row: &Row) -> Result<Grasp, Failure> {
        let (mut contacts, mut numbers) = (Vec::new(), Vec::new());
        for columns in &self.contacts {
            if let Some(contact) = columns.contact(table, row, self.asked)? {
                contacts.push(contact);
                numbers.push(columns.number);
            }
        }
        let vector = |columns: Option<[usize; 3]>| {
            columns.map_or(Ok(Vector3::zeros()), |columns| three(table, row, columns))
        };
        let (force, moment) = (three(table, row, self.force)?, vector(self.moment)?);
        let map = GraspMap::try_new(&contacts, vector(self.origin)?)
            .map_err(|error| table.error(row.line, &no_grasp(error, &numbers)))?;
        let load = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        Ok(Grasp { map, load, numbers })
    }
}

impl ContactColumns {
    fn find(table: &Table, asked: &Grip, number: usize) -> Result<Self, Failure> {
        let names = |parts: [&str; 3]| parts.map(|part| format!("{part}{number}"));
        let optional = |part: &str, default: Option<f32>, what: &str| {
            let name = format!("{part}{number}");
            match (table.column(&name), default) {
                (None, None) => table.needed(&name, what).map(Some),
                (column, _) => Ok(column),
            }
        };
        Ok(Self {
            number,
            place: all(table, names(PLACE), "place of a contact [m]")?,
            normal: all(table, names(NORMAL), "normal of a contact, into the object")?,
            friction: optional(FRICTION, asked.friction, "coefficient of friction, or --friction for all")?,
            limit: optional(LIMIT, asked.max, "largest normal force [N], or --max for all")?,
        })
    }

    fn all(&self) -> impl Iterator<Item = usize> {
        self.place.into_iter().chain(self.normal).chain(self.friction).chain(self.limit)
    }

    /// The contact, if the row has it.
    fn contact(&self, table: &Table, row: &Row, asked: &Grip) -> Result<Option<Contact>, Failure> {
        let Some(filled) = self.all().find(|&column| !table.is_empty(row, column)) else { return Ok(None) };
        let number = self.number;
        let wrong = |message: &str| table.error(row.line, message);
        if let Some(empty) =
            self.place.into_iter().chain(self.normal).find(|&column| table.is_empty(row, column))
        {
            let [empty, filled] = [empty, filled].map(|column| table.header(column));
            return Err(wrong(&format!(
                "column {empty} is empty, but {filled} is not: fill in place and normal of contact {number}, or nothing \
                 of it"
            )));
        }
        let (place, normal) = (three(table, row, self.place)?, three(table, row, self.normal)?);
        let value = |column: Option<usize>, default: Option<f32>, part, option| match (column, default) {
            (Some(column), _) if !table.is_empty(row, column) => table.number(row, column),
            (_, Some(default)) => Ok(default),
            _ => Err(wrong(&format!(
                "column {part}{number} is empty: fill in a number, or give {option} for all"
            ))),
        };
        let friction = value(self.friction, asked.friction, FRICTION, "--friction")?;
        let limit = value(self.limit, asked.max, LIMIT, "--max")?;
        if limit > 0.0 && limit < asked.min {
            let min = asked.min;
            return Err(wrong(&format!(
                "column {LIMIT}{number}: {limit} N is below the minimum normal force of {min} N (--min)"
            )));
        }
        let contact = Contact::try_new(place, normal, friction, limit);
        contact.map(Some).map_err(|error| wrong(&bad_contact(error, number, &normal)))
    }
}

/// Whether the table has a column of the contact.
fn mentioned(table: &Table, number: usize) -> bool {
    table.headers().iter().any(|header| contact_number(header) == Some(number))
}

/// Whether a column is that of a contact which cannot be.
fn beyond(header: &str) -> bool {
    contact_number(header).is_some_and(|number| !(1..=MAX_CONTACTS).contains(&number))
}

/// The contact of a column such as `nx3`.
fn contact_number(header: &str) -> Option<usize> {
    let digits = header.trim_start_matches(|c: char| !c.is_ascii_digit());
    let part = header.strip_suffix(digits)?;
    let known = PLACE.contains(&part) || NORMAL.contains(&part) || [FRICTION, LIMIT].contains(&part);
    digits.parse().ok().filter(|_| known)
}

fn all<S: AsRef<str>>(table: &Table, names: [S; 3], what: &str) -> Result<[usize; 3], Failure> {
    let [x, y, z] = names.map(|name| table.needed(name.as_ref(), what));
    Ok([x?, y?, z?])
}

fn all_or_none(table: &Table, names: [&str; 3], what: &str) -> Result<Option<[usize; 3]>, Failure> {
    let any = names.iter().any(|name| table.column(name).is_some());
    any.then(|| all(table, names, what)).transpose()
}

fn three(table: &Table, row: &Row, columns: [usize; 3]) -> Result<Vector3<f32>, Failure> {
    let [x, y, z] = columns.map(|column| table.number(row, column));
    Ok(Vector3::new(x?, y?, z?))
}

fn bad_contact(error: InvalidContact, number: usize, normal: &Vector3<f32>) -> String {
    match error {
        InvalidContact::Position => {
            format!("columns x{number}, y{number}, z{number}: the place is too far away to compute")
        }
        InvalidContact::Normal => format!(
            "columns nx{number}, ny{number}, nz{number}: ({}, {}, {}) has no direction: give a vector into the object, of any \
             length from 1e-6 on",
            normal.x, normal.y, normal.z
        ),
        InvalidContact::Friction(value) => {
            format!("column {FRICTION}{number}: {value} is not a coefficient of friction: it is at least 0")
        }
        InvalidContact::Limit(value) => {
            format!("column {LIMIT}{number}: {value} N is not a largest normal force: it is more than 0")
        }
    }
}

fn no_grasp(error: GraspMapError, numbers: &[usize]) -> String {
    let number = |index: u8| numbers.get(usize::from(index)).copied().unwrap_or_default();
    match error {
        GraspMapError::Contacts(0) => format!("no contact is filled in: a grasp has 2 to {MAX_CONTACTS}"),
        GraspMapError::Contacts(count) => {
            let only = numbers.first().copied().unwrap_or_default();
            format!("only contact {only} is filled in, {count} in all: a grasp has 2 to {MAX_CONTACTS}")
        }
        GraspMapError::Origin => "columns ox, oy, oz: the point is too far away to compute".to_owned(),
        GraspMapError::Coincident { distance, .. } if !distance.is_finite() => {
            "the contacts are too far from each other to compute".to_owned()
        }
        GraspMapError::Coincident { first, second, distance } => {
            let (first, second) = (number(first), number(second));
            format!(
                "columns x{first} to z{first}, x{second} to z{second}: contacts {first} and {second} are at the same \
                 place, {distance} m from each other: leave one out"
            )
        }
    }
}
