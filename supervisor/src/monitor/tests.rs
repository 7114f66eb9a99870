use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::style::{Color, Modifier};

use super::screen::drop_colours;
use super::*;

fn joint(name: &str, position: f32) -> JointView {
    JointView {
        name: name.to_owned(),
        position,
        velocity: 0.125,
        reference: 0.5,
        lower: 0.0,
        upper: 1.5,
        torque: 0.15,
        torque_limit: 0.3,
        homed: true,
        history: (0_u8..100).map(|index| f32::from(index) / 100.0).collect(),
    }
}

fn view(joints: Vec<JointView>) -> View {
    View {
        title: "hand3 on /dev/ttyUSB0, firmware 0.1.0".to_owned(),
        mode: "enabled (joint servo)".to_owned(),
        state: State::Enabled,
        time: 3_723.4,
        joints,
        faults: Vec::new(),
        link: LinkView {
            open: true,
            rate: Some(99.0),
            expected_rate: 100.0,
            lost: 0,
            damaged: 0,
            round_trip_ms: Some(1.8),
            last_seconds: 0.0,
        },
        supply: Some(12.04),
        hint: "space stops".to_owned(),
    }
}

fn hand() -> View {
    let names = ["thumb", "index", "middle"];
    let mut joints = Vec::new();
    for (finger, name) in (0_u8..).zip(names) {
        for (knuckle, part) in (0_u8..).zip(["abduct", "mcp", "pip"]) {
            let mut joint = joint(&format!("{name}_{part}"), 0.0);
            let phase = f64::from(finger) + 0.6 * f64::from(knuckle);
            (joint.lower, joint.upper) = if knuckle == 0 { (-0.35, 0.35) } else { (-0.1, 1.6) };
            let (middle, reach) = if knuckle == 0 { (0.0, 0.2) } else { (0.7, 0.5) };
            joint.history.clear();
            for index in 0..240_u16 {
                #[expect(clippy::cast_possible_truncation)]
                joint.remember((middle + reach * (phase + f64::from(index) / 30.0).sin()) as f32);
            }
            joint.reference = joint.position + 0.13;
            joint.torque = 0.28 * (f32::from(knuckle) - 0.8) * (f32::from(finger) - 0.7);
            joints.push(joint);
        }
    }
    joints[4].remember(1.58);
    joints[7].remember(1.72);
    joints[7].torque = 0.33;
    joints[8].homed = false;
    let mut view = view(joints);
    view.faults =
        vec!["middle_mcp: position beyond its limit".into(), "supply was below 10.5 V for 12 ms".into()];
    view.hint = "faults unread: press f".into();
    view
}

fn buffer(width: u16, height: u16, paint: impl FnOnce(&mut ratatui::Frame)) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(paint).unwrap();
    terminal.backend().buffer().clone()
}

fn lines(buffer: &Buffer) -> Vec<String> {
    let row = |y| (0..buffer.area.width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..buffer.area.height).map(row).map(|line| line.trim_end().to_owned()).collect()
}

fn text(width: u16, height: u16, view: &View, selected: Option<usize>) -> Vec<String> {
    lines(&buffer(width, height, |frame| draw(frame, view, selected)))
}

/// Writes the drawn screen to a file for inspection: `TESAKI_MONITOR_DUMP=folder cargo test`.
fn dump(name: &str, buffer: &Buffer) {
    let Some(folder) = std::env::var_os("TESAKI_MONITOR_DUMP") else { return };
    let mut text = String::new();
    for y in 0..buffer.area.height {
        for x in 0..buffer.area.width {
            let cell = &buffer[(x, y)];
            text += &format!("{x}\t{y}\t{}\t{:?}\t{:?}\n", cell.symbol(), cell.fg, cell.modifier);
        }
    }
    std::fs::write(std::path::Path::new(&folder).join(name), text).expect("a folder to write to");
}

#[test]
fn pictures() {
    let mut sixteen =
        view((0_u8..16).map(|index| joint(&format!("joint_{index}"), f32::from(index) / 9.0)).collect());
    sixteen.faults = hand().faults;
    let pictures =
        [(100, 30, hand()), (80, 24, hand()), (160, 40, hand()), (60, 12, hand()), (80, 24, sixteen)];
    for (index, (width, height, view)) in (0_u8..).zip(pictures) {
        let shown = buffer(width, height, |frame| draw(frame, &view, Some(3)));
        dump(&format!("{index}-{width}x{height}.tsv"), &shown);
    }
    dump(
        "help.tsv",
        &buffer(80, 24, |frame| {
            draw(frame, &hand(), None);
            draw_help(frame);
        }),
    );
    dump(
        "faults.tsv",
        &buffer(80, 24, |frame| {
            draw(frame, &hand(), None);
            draw_faults(frame, &hand());
        }),
    );
}

#[test]
fn a_small_view() {
    let mut joints = vec![joint("index_mcp", 0.75), joint("index_pip", 1.6), joint("thumb", 0.03)];
    joints[1].torque = -0.31;
    joints[2].homed = false;
    assert_eq!(
        text(80, 12, &view(joints), Some(0)),
        [
            " ● ENABLED  hand3 on /dev/ttyUSB0, firmware 0.1.0                  up 1:02:03.4",
            " enabled (joint servo)                                            supply 12.0 V",
            "╭ joints: 3 ───────────────────────────────────────────────────────────────────╮",
            "│   joint     position                   rad    ref  rad/s torque           N·m│",
            "│▸  index_mcp ├───────◆──█──────────┤  0.750  0.500  0.125 ······│━━━···  0.150│",
            "│ ! index_pip ├───────◆─────────────▶  1.600  0.500  0.125 ◀━━━━━│······ -0.310│",
            "│ ○ thumb     ╌╌╌╌╌╌ not homed ╌╌╌╌╌╌  0.030  0.500  0.125 ······│━━━···  0.150│",
            "│                                                                              │",
            "╰───────────────────────────── █ measured  ◆ reference  ~ near limit  ! beyond ╯",
            " link open   99 of 100 frames/s   lost 0   damaged 0   last 0.0 s ago",
            " ▸ space stops",
            "  space  stop  d  disable  f  faults  ↑↓  joint  ?  help  q  quit",
        ]
    );
}

#[test]
fn sixteen_joints_fit_80x24() {
    let joints = (0..16).map(|index| joint(&format!("joint_{index}"), 0.5)).collect();
    let mut view = view(joints);
    view.faults.push("joint_3: too hot".into());
    let text = text(80, 24, &view, None).join("\n");
    for index in 0..16 {
        assert!(text.contains(&format!(" joint_{index} ")), "{index} in\n{text}");
    }
    assert!(text.contains("space stops") && text.contains("! joint_3: too hot") && text.contains("quit"));
}

#[test]
fn the_selected_joint_is_in_sight() {
    let view = view((0..30).map(|index| joint(&format!("joint_{index}"), 0.5)).collect());
    for selected in 0..30 {
        let text = text(60, 12, &view, Some(selected)).join("\n");
        assert!(text.contains(&format!("▸  joint_{selected} ")), "{selected} in\n{text}");
    }
}

#[test]
fn limits_are_told_in_signs_and_colours() {
    let cases = [
        (0.75, ' ', "█", Color::Green),
        (0.03, '~', "█", Color::Yellow),
        (1.47, '~', "█", Color::Yellow),
        (-0.01, '!', "◀", Color::Red),
        (1.51, '!', "▶", Color::Red),
    ];
    for (position, mark, sign, colour) in cases {
        let mut joint = joint("elbow", position);
        (joint.torque, joint.reference) = (0.0, 0.4);
        let buffer = buffer(80, 24, |frame| draw(frame, &view(vec![joint]), None));
        let row = &lines(&buffer)[4];
        assert!(row.contains(&format!("{mark} elbow")), "{position}: {row}");
        let half = ["▐", "▌"];
        let cell = (0..80)
            .map(|x| &buffer[(x, 4)])
            .find(|cell| cell.symbol() == sign || (sign == "█" && half.contains(&cell.symbol())));
        assert_eq!(cell.expect("a block").fg, colour, "{position}: {row}");
    }
}

#[test]
fn reference_on_the_block_is_a_hole_in_it() {
    let buffer = buffer(80, 24, |frame| draw(frame, &view(vec![joint("elbow", 0.5)]), None));
    let cell = (0..80).map(|x| &buffer[(x, 4)]).find(|cell| cell.symbol() == "◆").expect("a reference");
    assert!(cell.modifier.contains(Modifier::REVERSED) && cell.fg == Color::Green);
}

#[test]
fn tiny_terminals_are_told_so() {
    for (width, height) in [(59, 12), (60, 11), (20, 3)] {
        let text = text(width, height, &hand(), Some(2)).join("\n");
        assert!(text.contains("terminal too small"), "{text}");
    }
    for (width, height) in [(1, 1), (3, 2), (60, 1), (1, 40)] {
        buffer(width, height, |frame| {
            draw(frame, &hand(), None);
            draw_help(frame);
            draw_faults(frame, &hand());
        });
    }
}

#[test]
fn no_size_and_no_number_panics() {
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, -0.0, 0.0, 1e-30];
    for (index, &value) in odd.iter().enumerate() {
        let next = odd[(index + 1) % odd.len()];
        let mut joints = vec![joint("a", value); 7];
        joints[1].velocity = value;
        (joints[2].lower, joints[2].reference) = (value, next);
        (joints[3].upper, joints[3].lower) = (value, next);
        (joints[4].torque, joints[4].torque_limit) = (value, next);
        (joints[5].torque_limit, joints[5].history) = (value, odd.iter().copied().collect());
        (joints[6].history, joints[6].name) = (VecDeque::from([value]), "名前 ключ".repeat(9));
        let mut view = view(joints);
        (view.time, view.supply) = (f64::from(value), Some(value));
        (view.link.rate, view.link.last_seconds, view.link.round_trip_ms) = (Some(value), next, Some(value));
        for (width, height) in [(60, 12), (80, 24), (101, 31), (150, 40), (400, 100)] {
            for selected in [None, Some(0), Some(5), Some(6), Some(99)] {
                text(width, height, &view, selected);
            }
        }
    }
    for width in 55..180 {
        text(width, 12 + width % 30, &hand(), Some(3));
    }
    text(80, 24, &View::default(), Some(0));
}

#[test]
fn an_old_view_says_so() {
    let mut view = hand();
    (view.state, view.link.open, view.link.last_seconds) = (State::Lost, false, 3.2);
    let text = text(80, 24, &view, None).join("\n");
    assert!(text.contains("? LOST") && text.contains("outdated: no data for 3.2 s"), "{text}");
    assert!(text.contains("link closed !") && text.contains("last 3.2 s ago !"), "{text}");
}

#[test]
fn without_colours_the_text_is_the_same() {
    let mut plain = buffer(100, 30, |frame| draw(frame, &hand(), Some(3)));
    let before = lines(&plain);
    drop_colours(&mut plain);
    assert_eq!(lines(&plain), before);
    assert!(plain.content.iter().all(|cell| cell.fg == Color::Reset && cell.bg == Color::Reset));
}

#[test]
fn numbers_keep_their_width() {
    let numbers =
        [1.2346, -1.2346, 123.45, -1234.5, 12_345_678.0, -1e30, -0.0001, f32::NAN, f32::NEG_INFINITY];
    let texts = numbers.map(|value| joints::number(value, 3));
    assert_eq!(texts, ["1.235", "-1.235", "123.45", "-1234", "1e7", "-1e30", "0.000", "nan", "-inf"]);
}

#[test]
fn keys_mean_what_the_help_says() {
    let key = |code, modifiers| Key::from_event(&Event::Key(KeyEvent::new(code, modifiers)));
    let plain = |code| key(code, KeyModifiers::NONE);
    for code in [KeyCode::Char('q'), KeyCode::Esc] {
        assert_eq!(plain(code), Some(Key::Quit));
    }
    assert_eq!(key(KeyCode::Char('c'), KeyModifiers::CONTROL), Some(Key::Quit));
    assert_eq!(key(KeyCode::Char('d'), KeyModifiers::CONTROL), None);
    assert_eq!(plain(KeyCode::Char('c')), None);
    assert_eq!(plain(KeyCode::Char(' ')), Some(Key::Stop));
    assert_eq!(plain(KeyCode::Char('d')), Some(Key::Disable));
    assert_eq!(plain(KeyCode::Char('f')), Some(Key::ReadFaults));
    assert_eq!(key(KeyCode::Char('?'), KeyModifiers::SHIFT), Some(Key::Help));
    assert_eq!(plain(KeyCode::Up), Some(Key::Up));
    assert_eq!(plain(KeyCode::Down), Some(Key::Down));
    let released = KeyEvent::new_with_kind(KeyCode::Char('q'), KeyModifiers::NONE, KeyEventKind::Release);
    assert_eq!(Key::from_event(&Event::Key(released)), None);
    assert_eq!(Key::from_event(&Event::Resize(80, 24)), None);

    assert_eq!(Key::Down.select(None, 3), Some(0));
    assert_eq!(Key::Down.select(Some(2), 3), Some(2));
    assert_eq!(Key::Up.select(None, 3), Some(2));
    assert_eq!(Key::Up.select(Some(0), 3), Some(0));
    assert_eq!(Key::Up.select(Some(9), 0), None);
}
