use crate::hand::{Hand, JOINTS, URDF, VALUES, frame, urdf};
use tesaki_sim::plant::{Fixture, FixtureShape, ObjectValues, Plant, PlantError, PlantValues};

/// Returns the plant's error message for a hand with a changed URDF.
fn with_urdf(from: &str, to: &str) -> String {
    assert!(URDF.contains(from), "{from}");
    let mut hand = Hand::exact();
    hand.urdf = urdf(&URDF.replacen(from, to, 1));
    refusal(&hand)
}

fn refusal(hand: &Hand) -> String {
    match Plant::new(&hand.urdf, &hand.drives, &hand.values, &hand.options) {
        Ok(_) => panic!("accepted"),
        Err(error) => error.to_string(),
    }
}

/// Checks that the message contains all parts.
fn says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
}

#[test]
fn a_link_without_mass_is_named() {
    let mut hand = Hand::exact();
    for link in hand.urdf.robot.links.iter_mut().filter(|link| link.name == "finger2_lower") {
        link.inertial = urdf_rs::Inertial::default();
    }
    says(&refusal(&hand), &["finger2_lower", "finger2_bend", "no mass", "<inertial>"]);
}

#[test]
fn an_impossible_inertia_is_named() {
    let message = with_urdf("izz=\"4.9e-07\"", "izz=\"4.9e-05\"");
    says(&message, &["finger1_lower", "finger1_bend", "moments of inertia", "4.9"]);
}

#[test]
fn joints_that_do_not_work_are_named() {
    let swing = "<joint name=\"finger1_swing\" type=\"revolute\">";
    says(
        &with_urdf(swing, &swing.replace("revolute", "prismatic")),
        &["finger1_swing", "prismatic", "revolute"],
    );
    says(
        &with_urdf("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>"),
        &["finger1_swing", "axis", "direction"],
    );
    says(&with_urdf("lower=\"-1.0\"", "lower=\"1.5\""), &["finger1_swing", "1.5 to 1 rad"]);
}

#[test]
fn drives_and_joints_must_match() {
    let mut hand = Hand::exact();
    hand.drives[4].joint = "finger2_bent".to_owned();
    says(&refusal(&hand), &["\"finger2_bent\"", "the URDF does not have", "finger2_bend"]);
    let mut hand = Hand::exact();
    hand.drives.pop();
    says(&refusal(&hand), &["\"finger3_curl\"", "list of drives"]);
    let mut hand = Hand::exact();
    hand.drives[1] = hand.drives[0].clone();
    says(&refusal(&hand), &["finger1_swing", "two drives"]);
    let mut hand = Hand::exact();
    hand.options.posture = Some(vec![0.0; 3]);
    says(&refusal(&hand), &["posture", "3 joints", "9"]);
}

#[test]
fn plant_toml_is_checked() {
    let error = |from: &str, to: &str| {
        assert!(VALUES.contains(from), "{from}");
        PlantValues::from_toml(&VALUES.replacen(from, to, 1)).unwrap_err().to_string()
    };
    says(&error("spread = 0.2", "spread = 1.2"), &["mismatch.spread is 1.2", "below 1"]);
    says(&error("step = 0.001", "step = 0.003"), &["integration.step is 0.003", "whole part"]);
    says(&error("delay = 0.0003", "delay = 0.01"), &["inner_loop.delay", "sub-step"]);
    says(&error("bandwidth = 300.0", "bandwith = 300.0"), &["bandwith"]);
    let mut hand = Hand::exact();
    hand.values.posture.insert("finger4_bend".to_owned(), 0.1);
    says(&refusal(&hand), &["[posture]", "finger4_bend"]);
}

#[test]
fn bad_frames_are_refused_and_change_nothing() {
    let mut plant = Hand::exact().build();
    let before = plant.truth();
    let mut short = frame([0.0; JOINTS]);
    short.torques.pop();
    let error = plant.apply(&short).unwrap_err();
    assert_eq!(error, PlantError::Count { item: "the actuator frame", got: 8, expected: 9 });
    let mut torques = [0.1; JOINTS];
    torques[5] = f32::NAN;
    says(&plant.apply(&frame(torques)).unwrap_err().to_string(), &["finger2_curl", "NaN"]);
    assert_eq!(plant.truth(), before);
}

#[test]
fn an_object_and_fixed_bodies_are_not_simulated_together() {
    let mut hand = Hand::exact();
    hand.options.object = Some(
        ObjectValues::from_toml("shape = 'box'\nsize = [0.1, 0.1, 0.1]\nmass = 0.1\nfriction = 0.5").unwrap(),
    );
    let shape = FixtureShape::Box { size: [1.0; 3] };
    let pose = rapier3d::na::Isometry3::identity();
    hand.options.fixtures = vec![Fixture { name: "door".into(), shape, pose, friction: 0.5 }];
    says(&refusal(&hand), &["object", "fixtures", "remove"]);
}
