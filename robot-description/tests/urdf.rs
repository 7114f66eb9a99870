//! URDF files: what is said about bad ones, by line, and the paths through good ones.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use tesaki_description::finding::Finding;
use tesaki_description::urdf::{Drive, Urdf};

/// An arm of two joints that carries two fingers, one with a coupled joint; a slide beside them.
const ROBOT: &str = r#"<?xml version="1.0"?>
<robot name="armhand">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1"/>
    <axis xyz="0 0 2"/>
    <limit lower="-1" upper="1.5" effort="5" velocity="2"/>
  </joint>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0 0"/>
      <mass value="0.5"/>
      <inertia ixx="1e-4" iyy="2e-3" izz="2e-3" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="wrist" type="continuous">
    <parent link="upper"/><child link="palm"/>
    <origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/>
    <axis xyz="0 0 1"/>
  </joint>
  <link name="palm"/>
  <joint name="thumb_base" type="revolute">
    <parent link="palm"/><child link="thumb"/>
    <origin xyz="0.02 0 0.05"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="6"/>
  </joint>
  <link name="thumb"/>
  <joint name="thumb_end" type="fixed">
    <parent link="thumb"/><child link="thumb_tip"/>
    <origin xyz="0 0 0.04"/>
  </joint>
  <link name="thumb_tip"/>
  <joint name="index_base" type="revolute">
    <parent link="palm"/><child link="index"/>
    <origin xyz="-0.02 0 0.05"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="6"/>
  </joint>
  <link name="index"/>
  <joint name="index_curl" type="revolute">
    <parent link="index"/><child link="index_tip"/>
    <origin xyz="0 0 0.04"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="6"/>
    <mimic joint="index_base" multiplier="0.8" offset="0.1"/>
  </joint>
  <link name="index_tip"/>
  <joint name="slide" type="prismatic">
    <parent link="palm"/><child link="ejector"/>
    <axis xyz="0 0 1"/>
    <limit lower="0" upper="0.02" effort="1" velocity="0.1"/>
  </joint>
  <link name="ejector"/>
</robot>
"#;

fn check(text: &str) -> (Option<Urdf>, Vec<Finding>) {
    Urdf::check(Path::new("my_hand/robot.urdf"), text)
}

/// The text with `from` replaced by `to` where it first occurs after `after`.
fn changed(after: &str, from: &str, to: &str) -> String {
    let start = ROBOT.find(after).unwrap();
    let (head, tail) = ROBOT.split_at(start);
    assert!(tail.contains(from), "{from}");
    head.to_owned() + &tail.replacen(from, to, 1)
}

/// The line of `what` after `after`.
fn line(text: &str, after: &str, what: &str) -> usize {
    let start = text.find(after).unwrap();
    let at = start + text[start..].find(what).unwrap();
    text[..at].matches('\n').count() + 1
}

#[test]
fn a_good_robot_has_nothing_wrong() {
    let (urdf, findings) = check(ROBOT);
    assert!(findings.is_empty(), "{findings:?}");
    let urdf = urdf.unwrap();
    assert_eq!(urdf.base(), "base");
    assert_eq!(urdf.tips(None), ["thumb_tip", "index_tip", "ejector"]);
    assert_eq!(urdf.reachable_tips(None), ["thumb_tip", "index_tip", "palm"]);
    assert_eq!(urdf.tips(Some("index")), ["index_tip"]);
    assert_eq!(urdf.reachable_tips(Some("palm")), ["thumb_tip", "index_tip"]);
}

/// What is changed (after, from, to), where the finding is (after, what), and what it says.
type Case =
    ((&'static str, &'static str, &'static str), (&'static str, &'static str), &'static [&'static str]);

const CASES: &[Case] = &[
    // XML
    (("wrist", "<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 1>"), ("wrist", "</joint"), &["XML", "quotes"]),
    (("\n</robot>", "\n</robot>", ""), ("<link name=\"ejector\"", "link"), &["never closed"]),
    (
        (
            "<robot",
            "<robot name=\"armhand\">",
            "<robot name=\"armhand\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><xacro:x/>",
        ),
        ("<xacro", "<xacro"),
        &["xacro:x", "xacro FILE.xacro > robot.urdf"],
    ),
    // The tree
    (
        ("wrist", "link=\"palm\"", "link=\"plam\""),
        ("wrist", "<parent"),
        &["joint wrist", "child link \"plam\" does not exist", "palm"],
    ),
    (
        ("wrist", "<parent link=\"upper\"/>", ""),
        ("<joint name=\"wrist\"", "<joint"),
        &["joint wrist has no parent", "add <parent"],
    ),
    (
        ("name=\"slide\"", "link=\"ejector\"", "link=\"index\""),
        ("<joint name=\"slide\"", "<joint"),
        &["\"index\" is the child of two joints, index_base (line 35) and slide", "loop", "mimic"],
    ),
    (
        ("shoulder", "<parent link=\"base\"/>", "<parent link=\"thumb_tip\"/>"),
        ("<joint name=\"shoulder\"", "<joint"),
        &["loop: ", "shoulder, thumb_end, thumb_base, wrist"],
    ),
    (
        (
            "<link name=\"ejector\"/>",
            "<link name=\"ejector\"/>",
            "<link name=\"ejector\"/><link name=\"alone\"/>",
        ),
        ("alone", "alone"),
        &["two bases", "\"base\" (line 3)", "\"alone\"", "add the joint"],
    ),
    (
        ("name=\"slide\"", "slide", "thumb_base"),
        ("<joint name=\"thumb_base\" type=\"prismatic\"", "<joint"),
        &["joint thumb_base exists twice, first in line 23", "names must be unique"],
    ),
    (
        ("<link name=\"thumb\"/>", "<link name=\"thumb\"/>", "<link name=\"thumb\"/><link name=\"palm\"/>"),
        ("<link name=\"thumb\"/>", "<link name=\"palm\""),
        &["link palm exists twice", "line 22"],
    ),
    (
        ("wrist", "continuous", "revolut"),
        ("<joint name=\"wrist\"", "<joint"),
        &["joint wrist", "unknown joint type \"revolut\"", "revolute, continuous"],
    ),
    // Numbers
    (
        ("shoulder", "xyz=\"0 0 0.1\"", "xyz=\"0 0 0,1\""),
        ("shoulder", "<origin"),
        &["joint shoulder", "\"0,1\" is not a finite number", "with a point"],
    ),
    (
        ("shoulder", "xyz=\"0 0 0.1\"", "xyz=\"0 nan 0.1\""),
        ("shoulder", "<origin"),
        &["joint shoulder", "\"nan\" is not a finite number"],
    ),
    (
        ("shoulder", "upper=\"1.5\"", "upper=\"inf\""),
        ("shoulder", "<limit"),
        &["joint shoulder", "\"inf\" is not a finite number"],
    ),
    (
        ("shoulder", "xyz=\"0 0 0.1\"", "xyz=\"0 0.1\""),
        ("shoulder", "<origin"),
        &["joint shoulder", "2 numbers, 3 expected"],
    ),
    (
        ("shoulder", "upper=\"1.5\"", "upper=\"${pi}\""),
        ("shoulder", "<limit"),
        &["joint shoulder", "xacro expression"],
    ),
    (("<mass", "0.5", "0.5 kg"), ("<mass", "<mass"), &["link upper", "\"kg\" is not a finite number"]),
    (("shoulder", "velocity=\"2\"", ""), ("shoulder", "<limit"), &["joint shoulder", "no velocity", "rad/s"]),
    (("<inertia ", "iyy=\"2e-3\"", ""), ("<inertia ", "<inertia"), &["link upper", "no iyy"]),
    (
        ("<mass", "<mass value=\"0.5\"/>", "<mass value=\"0.5\"/><mass value=\"0.4\"/>"),
        ("<mass", "<mass"),
        &["link upper: a second <mass>"],
    ),
    (
        (
            "<link name=\"palm\"/>",
            "<link name=\"palm\"/>",
            "<link name=\"palm\"><visual><geometry><sphere/></geometry></visual></link>",
        ),
        ("<sphere", "<sphere"),
        &["link palm: <sphere> has no radius"],
    ),
    // What only urdf-rs tells
    (
        ("<link name=\"base\"/>", "<link name=\"base\"/>", "<link name=\"base\"/>\n  <material/>"),
        ("<material", "<material"),
        &["material", "name"],
    ),
    (
        (
            "<link name=\"base\"/>",
            "<link name=\"base\"/>",
            "<material name=\"red\">\n<color rgba=\"1 0 0\"/></material><link name=\"base\"/>",
        ),
        ("<color", "<color"),
        &["material red: <color rgba=\"1 0 0\">", "3 numbers, 4 expected"],
    ),
    (
        (
            "<link name=\"palm\"/>",
            "<link name=\"palm\"/>",
            "<link name=\"palm\"><visual><geometry><sphere radius=\"1\"/></geometry>\n<material name=\"a\">\n\
             <color/></material></visual></link>",
        ),
        ("<color", "<color"),
        &["link palm: <color>", "rgba"],
    ),
    (
        ("shoulder", "velocity=\"2\"/>", "velocity=\"2\"/>\n    <safety_controller k_position=\"1\"/>"),
        ("<safety", "<safety"),
        &["joint shoulder: <safety_controller>", "k_velocity"],
    ),
    // Joints
    (
        ("shoulder", "xyz=\"0 0 2\"", "xyz=\"0 0 0\""),
        ("shoulder", "<axis"),
        &["joint shoulder", "not a direction", "0 0 1"],
    ),
    (
        ("shoulder", "<limit lower=\"-1\" upper=\"1.5\" effort=\"5\" velocity=\"2\"/>", ""),
        ("<joint name=\"shoulder\"", "<joint"),
        &["joint shoulder", "lower = upper = 0", "limits are missing", "<limit lower"],
    ),
    (
        ("shoulder", "lower=\"-1\" upper=\"1.5\"", ""),
        ("shoulder", "<limit"),
        &["joint shoulder", "lower = upper = 0", "limits are missing"],
    ),
    (
        ("shoulder", "effort=\"5\"", "effort=\"-5\""),
        ("shoulder", "<limit"),
        &["joint shoulder", "effort = -5 is below 0", "a magnitude"],
    ),
    (
        ("shoulder", "lower=\"-1\"", "lower=\"2\""),
        ("shoulder", "<limit"),
        &["joint shoulder", "lower = 2 is not below upper = 1.5", "swap"],
    ),
    (
        ("shoulder", "lower=\"-1\" upper=\"1.5\"", "lower=\"-90\" upper=\"90\""),
        ("shoulder", "<limit"),
        &["joint shoulder", "-90 to 90 rad", "degrees?", "-90° are -1.5708"],
    ),
    (
        ("wrist", "0.3 0 0", "300 0 0"),
        ("wrist", "<origin"),
        &["joint wrist", "300 m", "5 m", "millimetres?", "300 mm are 0.3"],
    ),
    (
        ("wrist", "1.5707963267948966", "90"),
        ("wrist", "<origin"),
        &["joint wrist", "rpy of 90 rad", "degrees?", "1.5708"],
    ),
    (
        ("index_curl", "joint=\"index_base\"", "joint=\"index_bas\""),
        ("index_curl", "<mimic"),
        &["joint index_curl mimics \"index_bas\", which does not exist", "index_base"],
    ),
    (
        ("index_curl", "joint=\"index_base\"", "joint=\"index_curl\""),
        ("index_curl", "<mimic"),
        &["joint index_curl mimics itself"],
    ),
    // Masses
    (("<mass", "0.5", "1500"), ("<mass", "<mass"), &["link upper", "mass = 1500 kg", "grams?", "are 1.5"]),
    (("<mass", "0.5", "-0.5"), ("<mass", "<mass"), &["link upper", "mass = -0.5 kg is below 0"]),
    (("<mass", "0.5", "0"), ("<mass", "<mass"), &["link upper", "mass = 0 kg, but its inertia is not 0"]),
    (
        ("<inertia ", "ixx=\"1e-4\"", "ixx=\"-1e-4\""),
        ("<inertia ", "<inertia"),
        &["link upper", "principal moments -1.000e-4", "negative"],
    ),
    (
        ("<inertia ", "ixx=\"1e-4\"", "ixx=\"9e-3\""),
        ("<inertia ", "<inertia"),
        &["link upper", "exceeds the sum", "9.000e-3"],
    ),
    (
        ("<inertia ", "ixx=\"1e-4\" iyy=\"2e-3\" izz=\"2e-3\"", "ixx=\"100\" iyy=\"2000\" izz=\"2000\""),
        ("<inertia ", "<inertia"),
        &["link upper", "radius of gyration 63.246 m", "2 m", "kg·mm²"],
    ),
    (
        ("<inertia ", "ixx=\"1e-4\"", "ixx=\"1e300\""),
        ("<inertia ", "<inertia"),
        &["link upper", "1e300 kg·m²", "kg·mm²"],
    ),
    (
        ("<inertial", "xyz=\"0.1 0 0\"", "xyz=\"100 0 0\""),
        ("<inertial", "<origin"),
        &["link upper", "centre of mass 100 m", "100 mm are 0.1"],
    ),
];

#[test]
fn every_bad_input_is_told_by_name_line_and_advice() {
    let mut failed = String::new();
    for ((after, from, to), (near, what), words) in CASES {
        let text = changed(after, from, to);
        let (_, findings) = check(&text);
        let said = findings.iter().map(|finding| format!("{finding}\n")).collect::<String>();
        let place = format!("my_hand/robot.urdf:{}: ", line(&text, near, what));
        let well = matches!(&*findings, [one] if one.is_error() && !one.advice.is_empty());
        if !well || !said.starts_with(&place) || !words.iter().all(|word| said.contains(word)) {
            failed += &format!("{from} → {to}: expected {place} with {words:?}, got {said}\n");
        }
    }
    assert!(failed.is_empty(), "{failed}");
}

/// What `ROBOT` does not have.
const RICHER: &str = r#"
  <material name="red"><color rgba="1 0 0 1"/></material>
  <material name="wood"><texture filename="wood.png"/></material>
  <link name="shell">
    <visual>
      <origin xyz="0 0 0" rpy="0 0 0"/>
      <geometry><box size="1 1 1"/></geometry>
      <material name="red"/>
    </visual>
    <collision><geometry><cylinder radius="1" length="1"/></geometry></collision>
    <collision><geometry><mesh filename="a.stl" scale="1 1 1"/></geometry></collision>
  </link>
  <joint name="to_shell" type="revolute">
    <parent link="palm"/>
    <child link="shell"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="1.6" effort="1" velocity="6"/>
    <calibration rising="0"/>
    <dynamics damping="0.1" friction="0.1"/>
    <safety_controller soft_lower_limit="0" soft_upper_limit="1.6" k_position="1" k_velocity="1"/>
  </joint>
</robot>
"#;

/// Every attribute is removed, emptied, and replaced by a word; every element is removed, written twice, and
/// left without its end: whatever is an error then has a line.
#[test]
fn no_damage_leads_to_an_error_without_a_line() {
    let text = ROBOT.replace("</robot>", RICHER.trim());
    assert_eq!(check(&text).1, [], "before the damage");
    let document = roxmltree::Document::parse(&text).unwrap();
    let mut damaged = Vec::new();
    let mut replace = |range: std::ops::Range<usize>, by: &str| {
        let text = format!("{}{by}{}", &text[..range.start], &text[range.end..]);
        damaged.push(text);
    };
    for node in document.descendants().filter(roxmltree::Node::is_element) {
        for attribute in node.attributes() {
            replace(attribute.range(), "");
            for value in ["", "word", "-1", "1 2 3 4 5"] {
                replace(attribute.range_value(), value);
            }
        }
        let element = &text[node.range()];
        replace(node.range(), "");
        replace(node.range(), "<unknown/>");
        replace(node.range(), &element.repeat(2));
        replace(node.range(), element.trim_end_matches('>'));
        replace(node.range(), &element.replacen(node.tag_name().name(), "unknown", 1));
    }
    assert!(damaged.len() > 500, "{}", damaged.len());
    for text in damaged {
        let (urdf, findings) = check(&text);
        assert!(urdf.is_some() || findings.iter().any(Finding::is_error), "{text}");
        for finding in findings {
            assert!(finding.line.is_some_and(|line| line <= text.lines().count()), "{finding}\n{text}");
        }
    }
}

#[test]
fn a_robot_in_millimetres_is_noticed_by_its_whole_length() {
    let mut text = r#"<robot name="r"><link name="l0"/>"#.to_owned();
    for i in 0..6 {
        text += &format!(
            "\n<joint name=\"j{i}\" type=\"continuous\"><origin xyz=\"0 0 4\"/><axis xyz=\"0 1 0\"/><parent link=\"l{i}\"/><child link=\"l{}\"/></joint><link name=\"l{}\"/>",
            i + 1,
            i + 1
        );
    }
    let (_, findings) = check(&(text + "</robot>"));
    let said = findings[0].to_string();
    assert!(findings.len() == 1 && said.contains("robot.urdf:7: link l6: 24 m from the base"), "{said}");
    assert!(said.contains("20 m") && said.contains("millimetres?"), "{said}");
}

#[test]
fn mimic_joints_in_a_circle_are_found_from_each_of_them() {
    let text = changed("index_base", "velocity=\"6\"/>", "velocity=\"6\"/><mimic joint=\"index_curl\"/>");
    let (_, findings) = check(&text);
    assert_eq!(findings.len(), 2, "{findings:#?}");
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert!(said[0].contains("robot.urdf:39: joint index_base mimics itself indirectly"), "{said:?}");
    assert!(said[1].contains("robot.urdf:47: joint index_curl mimics itself indirectly"), "{said:?}");
}

#[test]
fn many_mistakes_are_told_together_and_a_missing_axis_is_a_warning() {
    let text = ROBOT
        .replacen("<axis xyz=\"0 0 2\"/>", "", 1)
        .replacen("0.3 0 0", "300 0 0", 1)
        .replacen("value=\"0.5\"", "value=\"5000\"", 1)
        .replacen("<parent link=\"thumb\"/>", "<parent link=\"thump\"/>", 1);
    let (urdf, findings) = check(&text);
    assert!(urdf.is_none());
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert_eq!(findings.len(), 4, "{said:#?}");
    for word in ["has no <axis>", "300 m", "5000 kg", "\"thump\" does not exist"] {
        assert!(said.iter().any(|text| text.contains(word)), "{word}: {said:#?}");
    }
    assert_eq!(findings.iter().filter(|finding| finding.is_error()).count(), 3);
}

#[test]
fn soft_limits_are_said_to_be_unused_where_they_are_narrower() {
    for (soft, is_told) in [("-0.5", true), ("-1", false)] {
        let soft = format!(
            "velocity=\"2\"/>\n    <safety_controller soft_lower_limit=\"{soft}\" soft_upper_limit=\"1.5\" \
             k_velocity=\"1\"/>"
        );
        let (urdf, findings) = check(&changed("shoulder", "velocity=\"2\"/>", &soft));
        let told =
            findings.iter().any(|finding| !finding.is_error() && finding.message.contains("soft limits"));
        assert!(urdf.is_some() && told == is_told, "{findings:?}");
    }
}

/// `urdf-rs` ignores what it does not know: a rotation of 0, no limit.
#[test]
fn names_that_are_nearly_known_are_warned_of_by_line() {
    for (from, to, expected) in [
        ("limit lower=", "limit lowr=", "joint shoulder: <limit>: unknown attribute lowr"),
        ("inertial>", "inertal>", "link upper: unknown element <inertal>"),
        ("multiplier=", "multipler=", "<mimic>: unknown attribute multipler"),
        ("rpy=", "rpi=", "joint wrist: <origin>: unknown attribute rpi"),
    ] {
        let text = ROBOT.replace(from, to);
        let (_, findings) = check(&text);
        let said = findings.iter().map(ToString::to_string).collect::<String>();
        assert!(said.contains(expected) && said.contains("it is ignored: write"), "{to}: {said}");
    }
    let known = check(ROBOT).1.len();
    assert_eq!(check(&ROBOT.replacen("<limit ", "<limit acceleration=\"3\" ", 1)).1.len(), known);
}

#[test]
fn words_that_are_no_urdf_say_so() {
    let deep = format!("<robot name=\"x\">{}{}</robot>", "<a>".repeat(5000), "</a>".repeat(5000));
    for (text, expected) in [
        ("", "malformed XML"),
        ("<robt/>", "<robt> is not a robot"),
        ("<robot name=\"x\"/>", "no links"),
        ("<robot name=\"x\"><link/></robot>", "a link without a name"),
        ("<robot name=\"x\"><link name=\"a&#10;b\"/></robot>", "a link with the name \"a\\nb\""),
        ("<robot name=\"x\"><link name=\"a\"/><joint name=\"*\"/></robot>", "a joint with the name \"*\""),
        ("<robot name=\"x\"><xacro:arm/></robot>", "`xacro FILE.xacro > robot.urdf`"),
        ("<robot name=\"x\"><drake:arm/></robot>", "<robot xmlns:drake="),
        ("<!DOCTYPE robot><robot name=\"x\"/>", "a URDF needs none"),
        (&deep, "more than 64 levels deep"),
    ] {
        let (urdf, findings) = check(text);
        let said = findings.iter().map(ToString::to_string).collect::<String>();
        assert!(urdf.is_none() && said.contains(expected), "{text}: {said}");
    }
}

/// Exporters write them for links without a surface.
#[test]
fn shapes_that_are_none_are_ignored_with_a_warning_in_their_line() {
    let shapes = "  <collision><geometry><mesh filename=\"\"/></geometry></collision>\n  <visual/>\n  \
        <visual><geometry/></visual>\n  <visual><geometry><mesh/></geometry></visual>\n  \
        <visual><geometry><sphere radius=\"0.01\"/></geometry></visual>\n";
    let text = ROBOT.replacen("<link name=\"upper\">\n", &format!("<link name=\"upper\">\n{shapes}"), 1);
    let (urdf, findings) = check(&text);
    assert_eq!(urdf.unwrap().robot.links[1].visual.len(), 1);
    let first = line(&text, "<link name=\"upper\">", "<collision>");
    let said: Vec<String> = findings.iter().map(ToString::to_string).collect();
    assert_eq!(said.len(), 4, "{said:?}");
    for (line, said) in (first..).zip(&said) {
        let place = format!("robot.urdf:{line}: link upper: its <");
        assert!(said.contains(&place) && said.contains("has no shape; it is ignored"), "{said}");
    }
    assert!(findings.iter().all(|finding| !finding.is_error()));
}

/// As in the URDF of iCub. Textures are for programs that draw.
#[test]
fn textures_without_a_file_are_nothing() {
    let material = "<material name=\"grey\"><color rgba=\"1 1 1 1\"/><texture/></material>";
    let sphere = "<geometry><sphere radius=\"0.01\"/></geometry>";
    let visual = format!("<visual>{sphere}{material}</visual><visual><geometry/>{material}</visual>\n");
    let text = ROBOT.replacen("<link name=\"upper\">\n", &format!("<link name=\"upper\">\n{visual}"), 1);
    let text = text.replacen("</robot>", &format!("{material}</robot>"), 1);
    let (urdf, findings) = check(&text);
    assert_eq!(findings.len(), 1, "{findings:?}");
    assert!(findings[0].to_string().contains("has no shape"), "{findings:?}");
    assert_eq!(urdf.unwrap().robot.links[1].visual.len(), 1);
}

#[test]
fn a_path_goes_through_the_arm_to_one_fingertip_and_folds_what_is_fixed() {
    let urdf = check(ROBOT).0.unwrap();
    let path = urdf.path(None, "thumb_tip").unwrap();
    let names: Vec<&str> = path.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["shoulder", "wrist", "thumb_base"]);
    assert!((nalgebra::Vector3::from(path.joints[0].axis) - nalgebra::Vector3::z()).norm() < 1e-7);
    assert_eq!(path.joints[0].limits, Some((-1.0, 1.5)));
    assert_eq!(path.joints[1].limits, None);
    assert!((path.joints[0].link.mass - 0.5).abs() < 1e-7);
    assert!((path.pose.translation[2] - 0.04).abs() < 1e-7);
    // Straight: up 0.1, out 0.3 along x, where the palm's z points; the thumb's offset (0.02, 0, 0.05), the
    // tip 0.04.
    let tip = path.chain().posture(&path.angles(&[0.0; 3])).tip().translation.vector;
    assert!((tip - nalgebra::Vector3::new(0.39, 0.0, 0.08)).norm() < 1e-6, "{tip}");
    // From the palm there is the finger alone.
    let path = urdf.path(Some("palm"), "thumb_tip").unwrap();
    assert_eq!((path.joints.len(), path.base.as_str()), (1, "palm"));
    let tip = path.chain().posture(&[0.0]).tip().translation.vector;
    assert!((tip - nalgebra::Vector3::new(0.02, 0.0, 0.09)).norm() < 1e-6, "{tip}");
}

#[test]
fn a_mimic_joint_follows_its_drive() {
    let urdf = check(ROBOT).0.unwrap();
    let path = urdf.path(Some("palm"), "index_tip").unwrap();
    assert_eq!(path.drives, [Drive { name: "index_base".to_owned(), limits: Some((0.0, 1.6)) }]);
    assert_eq!(path.angles(&[0.5]), [0.5, 0.5]);
    // Also when the one it follows is not on the path, and through another mimic joint.
    let text = changed(
        "index_base",
        "velocity=\"6\"/>",
        "velocity=\"6\"/><mimic joint=\"thumb_base\" multiplier=\"-2\"/>",
    );
    let urdf = check(&text).0.unwrap();
    let path = urdf.path(Some("palm"), "index_tip").unwrap();
    assert_eq!(path.drives[0].name, "thumb_base");
    assert_eq!(path.angles(&[0.5]), [-1.0, -0.7]);
}

#[test]
fn paths_that_cannot_be_computed_say_why_and_which_can() {
    let urdf = check(ROBOT).0.unwrap();
    let refused = |base: Option<&str>, tip: &str| urdf.path(base, tip).map(|_| ()).unwrap_err().to_string();
    for (base, tip, words) in [
        (None, "ejector", &["robot.urdf:50", "joint slide", "prismatic", "thumb_tip, index_tip, palm"][..]),
        (None, "nail", &["no link \"nail\"", "thumb_tip"]),
        (Some("thumb"), "index_tip", &["\"thumb\" is not between", "--base"]),
        (Some("thumb"), "thumb_tip", &["there is no moving joint between thumb and thumb_tip"]),
    ] {
        let said = refused(base, tip);
        for word in words {
            assert!(said.contains(word), "{tip}: no {word:?} in: {said}");
        }
    }
    let text = changed("index_base", "velocity=\"6\"/>", "velocity=\"6\"/><mimic joint=\"slide\"/>");
    let said = check(&text).0.unwrap().path(None, "index_tip").map(|_| ()).unwrap_err().to_string();
    assert!(said.contains("index_base mimics slide, which is prismatic"), "{said}");
}

#[test]
fn more_than_seven_joints_are_too_many_unless_a_base_further_out_is_named() {
    let mut text = r#"<robot name="r"><link name="l0"/>"#.to_owned();
    for i in 0..9 {
        text += &format!(
            "\n<joint name=\"j{i}\" type=\"continuous\"><axis xyz=\"0 1 0\"/><parent link=\"l{i}\"/><child link=\"l{}\"/></joint><link name=\"l{}\"/>",
            i + 1,
            i + 1
        );
    }
    let urdf = check(&(text + "</robot>")).0.unwrap();
    let said = urdf.path(None, "l9").map(|_| ()).unwrap_err().to_string();
    assert!(said.contains("9 moving joints from l0 to l9; at most 7 are supported"), "{said}");
    assert!(said.contains("--base l2") && said.contains("from l0: l7"), "{said}");
    assert_eq!(urdf.path(Some("l2"), "l9").unwrap().joints.len(), 7);
    assert_eq!(urdf.path(None, "l7").unwrap().joints.len(), 7);
    assert_eq!(urdf.reachable_tips(None), ["l7"]);
}

/// What is said of the text.
fn said(text: &str) -> Vec<String> {
    check(text).1.iter().map(ToString::to_string).collect()
}

#[test]
fn materials_are_told_in_words() {
    let words = |material: &str| {
        said(&ROBOT.replacen("<link name=\"base\"/>", &format!("{material}<link name=\"base\"/>"), 1))
    };
    let [empty] = &words("<material/>")[..] else { panic!() };
    assert!(empty.contains("robot.urdf:3: material: it has no name; add name=\"…\""), "{empty}");
    let [short] = &words("<material name=\"q\"><color rgba=\"1 0 0\"/></material>")[..] else { panic!() };
    assert!(
        short.contains("material q: <color rgba=\"1 0 0\">: 3 numbers, 4 expected; write numbers"),
        "{short}"
    );
}

#[test]
fn the_inertia_of_a_link_that_no_joint_moves_prevents_nothing() {
    let inertial = |inertia: &str| {
        format!(
            "<link name=\"base\"><inertial><mass value=\"1\"/><inertia ixx=\"{inertia}\" iyy=\"1e-4\" izz=\"1e-4\" \
             ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"
        )
    };
    let text = ROBOT.replacen("<link name=\"base\"/>", &inertial("1e-1"), 1);
    let (_, findings) = check(&text);
    let [found] = &findings[..] else { panic!("{findings:?}") };
    assert!(!found.is_error() && found.advice.contains("no joint moves it"), "{found}");
    assert!(found.message.contains("link base: physically impossible inertia"), "{found}");
    // Behind a joint it does.
    let (_, findings) = check(&changed("name=\"upper\"", "ixx=\"1e-4\"", "ixx=\"1\""));
    assert!(findings.iter().any(Finding::is_error), "{findings:?}");
}

#[test]
fn limits_beyond_all_angles_are_none() {
    let [said] =
        &said(&changed("shoulder", "lower=\"-1\" upper=\"1.5\"", "lower=\"-1e16\" upper=\"1e16\""))[..]
    else {
        panic!()
    };
    assert!(
        said.contains("joint shoulder: limits -1e16 to 1e16 rad are no limits at all; give real"),
        "{said}"
    );
}
