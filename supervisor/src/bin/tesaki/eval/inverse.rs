use super::{Results, Table};
use crate::failure::Failure;
use tesaki_supervisor::urdf::SerialPath;

pub fn angles(_table: &Table, _paths: &[SerialPath]) -> Result<Results, Failure> {
    Err(Failure::Other("not yet".to_owned()))
}
