//! The robots that come with tesaki, changed, for tests.

use std::path::Path;

use tesaki::model::RobotModel;

use super::limits::ImplausibleValue;
use crate::robot::RobotFolder;

/// Their names.
pub const NAMES: [&str; 7] = ["hand3", "arm7", "hand5", "knob-arm", "allegro", "leap", "inspire"];

/// A bound: the key of a value, how it is set, a value beyond the bound, and one within.
pub type Bounds = (&'static str, fn(&mut RobotModel, f32), f32, f32);

pub fn robot(name: &str) -> RobotModel {
    let robots = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots"));
    RobotFolder::load(&robots.join(name)).unwrap().model
}

/// Checks that `find` finds in hand3 just what is beyond each bound.
pub fn check_bounds(cases: &[Bounds], find: fn(&RobotModel) -> Vec<ImplausibleValue>) {
    for (key, change, wrong, right) in cases {
        let mut changed = robot("hand3");
        change(&mut changed, *wrong);
        let keys: Vec<&str> = find(&changed).iter().map(|value| value.key).collect();
        assert_eq!(keys, [*key], "{wrong}");
        change(&mut changed, *right);
        assert_eq!(find(&changed), [], "{key} = {right}");
    }
}
