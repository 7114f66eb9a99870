//! Force reflection: the master is an arm under impedance control, too, and feels the force that the slave
//! exerts.
//!
//! ```text
//!  handle ── spring of its impedance ── set-point │ master port ⇄ slave port │ set-point ── spring ── tool ── wall
//! ```
//!
//! The protocol carries set-points, not forces: the handle's set-point is displaced from the handle by the
//! force over the stiffness of its impedance. A [`PowerPort`] at each end keeps account of the energy.

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::{IsometryMatrix3, UnitQuaternion, Vector3};
use tesaki::TICK;
use tesaki::control::{Impedance, ImpedanceAxes};
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Refusal, Reply, Request};
use tesaki::task::impedance::{ImpedanceCommand, ImpedanceRefusal, ImpedanceSettings, ImpedanceTelemetry};
use tesaki::task::{TaskCommand, TaskConfig, TaskRefusal};
use tesaki::teleop::{PowerPort, PowerPortLimits, UnsuitableLink};
use tesaki_supervisor::Board;

use crate::args::Follow;
use crate::board_session::{BoardSession, refused};
use crate::failure::Failure;
use crate::motion::PERIOD;

/// Energy that the link may give before any has entered [J].
const ENERGY_RESERVE: f32 = 0.02;
/// Largest damping of the handle over its mass [1/s]: stable up to a delay of 0.3 s from the handle and back.
const MAX_DAMPING: f32 = 5.0;
/// Periods between a motion of the handle and the force that answers it, besides the time on the links: until
/// the slave's board has the set-point, until its force is read, and until the master's board has that.
const HELD: u32 = 3;
/// The set-point of the handle follows it outside of this distance and angle [m, rad]; within, its spring
/// keeps it where the operator leaves it.
const DEAD_BAND: [f32; 2] = [1e-3, 1e-2];
/// The set-point of the handle is displaced by at most this fraction of the largest deviation of its
/// settings.
const MAX_DISPLACEMENT: f32 = 0.5;
/// How long the end of the master is waited for.
const FAREWELL: Duration = Duration::from_secs(2);

/// What the operator feels.
#[derive(Clone, Copy, Default)]
pub struct Felt {
    /// Force on the handle, and the largest so far, damping included [N].
    pub force: f32,
    pub largest: f32,
    /// The limit of the force, if it is reached [N].
    pub limit: Option<f32>,
    /// Energy that has entered the link minus that which has left it [J].
    pub balance: f32,
}

/// What is asked of the master.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Order {
    #[default]
    Watch,
    Enable,
    End,
}

/// What both ends know of each other.
#[derive(Default)]
struct Exchange {
    order: Order,
    /// Force of the slave for the handle [N].
    force: Vector3<f32>,
    /// Energy that has entered at each end, and the balance of the master [µJ].
    master_energy: i64,
    slave_energy: i64,
    master_balance: i64,
    felt: Felt,
}

/// One for both ends.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Exchange>>);

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Exchange> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Both ends of a link between a master and a slave with these settings. The links of both boards take
/// `round_trip`.
pub fn link(
    (master, file): (&ImpedanceSettings, &Path),
    slave: &ImpedanceSettings,
    args: &Follow,
    round_trip: Duration,
) -> Result<(Handle, Reflection), Failure> {
    let stiffness = springs(&master.impedance, file)?;
    let of_slave = springs(&slave.impedance, &args.impedance)?;
    let least = |[x, y, z, ..]: [f32; 6]| x.min(y).min(z);
    let handle = [least(master.impedance.mass), least(master.impedance.damping)];
    let max_damping = MAX_DAMPING * handle[0];
    let limits = PowerPortLimits::try_new(max_damping, ENERGY_RESERVE)
        .map_err(|error| Failure::Usage(format!("--reflect: {error}")))?;
    let limits = check(&limits, handle, of_slave.max(), round_trip, args)?;
    let shared = Shared::default();
    let (sender, answer) = channel();
    let handle = Handle {
        shared: shared.clone(),
        answer: sender,
        settings: *master,
        stiffness,
        limits,
        port: PowerPort::new(),
        state: State::Off,
        elbow: ElbowSetpoint::default(),
        rest: None,
        before: None,
        force: Vector3::zeros(),
        damping: Vector3::zeros(),
    };
    let reflection = Reflection {
        shared,
        answer,
        stiffness: of_slave,
        scale: args.scale,
        limits,
        port: PowerPort::new(),
        contact: false,
        setpoint: None,
        push: Vector3::zeros(),
    };
    Ok((handle, reflection))
}

/// Refuses links with more delay than the damping of the handle, with its mass [kg] and its own damping
/// [N·s/m], is good for. Returns the limits with the damping in contact for this delay.
fn check(
    limits: &PowerPortLimits,
    handle: [f32; 2],
    stiffness: f32,
    round_trip: Duration,
    args: &Follow,
) -> Result<PowerPortLimits, Failure> {
    // Way and force are both scaled.
    let scaling = args.scale * args.scale;
    let delay = round_trip + HELD * PERIOD;
    let (scaled, seconds) = (stiffness * scaling, delay.as_secs_f32());
    let Err(unsuitable) = limits.check_link(handle, scaled, seconds) else {
        return Ok(limits.calm(handle[1], scaled, seconds));
    };
    Err(Failure::Usage(match unsuitable {
        UnsuitableLink::Delay { round_trip: delay, limit, stiffness: allowed } => format!(
            "--reflect: the force comes back {:.0} ms after the motion, {} ms of them {} on the links of master and slave; \
             with the {stiffness} N/m of {} {}: at most {:.0} N/m there, {:.0} N·s/m of damping in the file of the handle, a \
             smaller --scale, or faster links",
            1e3 * delay,
            round_trip.as_millis(),
            if args.round_trip.is_some() { "stated" } else { "measured" },
            args.impedance.display(),
            if limit > 0.0 {
                format!("the handle stays calm up to {:.1} ms", 1e3 * limit)
            } else {
                "the handle is not calm even without delay".to_owned()
            },
            f64::from(allowed / scaling).floor(),
            f64::from(scaled * (delay + 0.5 * TICK) - limits.max_damping()).ceil()
        ),
        other => format!("--reflect: {other}"),
    }))
}

/// Stiffness along the axes of the base [N/m].
fn springs(impedance: &Impedance, file: &Path) -> Result<Vector3<f32>, Failure> {
    let Impedance { stiffness: [x, y, z, ..], axes, coupling, .. } = *impedance;
    if axes == ImpedanceAxes::Base && coupling.is_none() && x.min(y).min(z) > 0.0 {
        return Ok(Vector3::new(x, y, z));
    }
    Err(Failure::Usage(format!(
        "{}: --reflect needs a stiffness above 0 along each axis of the base, without a matrix, and axes = \"base\"",
        file.display()
    )))
}

/// The slave's end.
pub struct Reflection {
    shared: Shared,
    /// Whether the master could be enabled; closed at its end.
    answer: Receiver<Result<(), Failure>>,
    /// Of the slave's impedance [N/m].
    stiffness: Vector3<f32>,
    scale: f32,
    limits: PowerPortLimits,
    port: PowerPort,
    contact: bool,
    /// Set-point of the tool as the board has it [m].
    setpoint: Option<Vector3<f32>>,
    /// Force of the link on the tool there, through the spring of its impedance [N].
    push: Vector3<f32>,
}

impl Reflection {
    /// Asks for the master to be enabled, with its set-point where it is. Returns the answer once it is
    /// there.
    pub fn enable_master(&self) -> Option<Result<(), Failure>> {
        self.shared.lock().order = Order::Enable;
        match self.answer.try_recv() {
            Ok(answer) => Some(answer),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(Failure::Other("it has ended".to_owned()))),
        }
    }

    /// Telemetry of the slave: accounts for the motion of its set-point, and reflects its force while it
    /// follows.
    pub fn heard(&mut self, tool: &ImpedanceTelemetry, follows: bool) {
        let [x, y, z, ..] = tool.error;
        let error = Vector3::new(x, y, z);
        let setpoint = Vector3::from(tool.position) - error;
        self.contact = tool.contact;
        let push = if tool.contact { -error.component_mul(&self.stiffness) } else { Vector3::zeros() };
        let displacement = self.setpoint.map_or_else(Vector3::zeros, |before| setpoint - before);
        self.port.account(&((push + self.push) * 0.5), &Vector3::zeros(), &displacement);
        (self.setpoint, self.push) = (Some(setpoint), push);
        let mut exchange = self.shared.lock();
        exchange.slave_energy = self.port.energy_in();
        exchange.force = if follows { push * -self.scale } else { Vector3::zeros() };
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        let balance = 1e-6 * exchange.master_balance.saturating_add(self.port.balance()) as f32;
        exchange.felt.balance = balance;
    }

    /// The set-point as far as the energy from the master allows.
    pub fn limit(&mut self, mut point: PosePoint) -> PosePoint {
        let Some(setpoint) = self.setpoint.filter(|_| self.contact) else { return point };
        let desired = Vector3::from(point.position) - setpoint;
        let push = self.push + desired.component_mul(&self.stiffness);
        let received = self.shared.lock().master_energy;
        let allowed = self.port.limit_displacement(&self.limits, received, &push, &desired);
        if allowed != desired {
            point.position = (setpoint + allowed).into();
        }
        // Towards a set-point that moves, the damper of the impedance would pull the tool with energy that
        // the port does not count.
        point.velocity[..3].fill(0.0);
        point.acceleration[..3].fill(0.0);
        point
    }

    pub fn felt(&self) -> Felt {
        self.shared.lock().felt
    }
}

/// However the program ends, the master is off.
impl Drop for Reflection {
    fn drop(&mut self) {
        self.shared.lock().order = Order::End;
        while self.answer.recv_timeout(FAREWELL).is_ok() {}
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Off,
    /// Telemetry of before may still arrive.
    Enabling,
    Enabled,
}

/// The master's end.
pub struct Handle {
    shared: Shared,
    answer: Sender<Result<(), Failure>>,
    settings: ImpedanceSettings,
    /// Of its impedance [N/m].
    stiffness: Vector3<f32>,
    limits: PowerPortLimits,
    port: PowerPort,
    state: State,
    elbow: ElbowSetpoint,
    /// Set-point without a force.
    rest: Option<(Vector3<f32>, UnitQuaternion<f32>)>,
    /// Tick and position of the last telemetry [m].
    before: Option<(u32, Vector3<f32>)>,
    /// Force of the slave and of the damping in the last period [N].
    force: Vector3<f32>,
    damping: Vector3<f32>,
}

impl Handle {
    /// A refused set-point is followed by the next one; any other refusal is an error.
    pub fn check(reply: &Reply) -> Result<(), Failure> {
        match reply {
            Reply::Refused(Refusal::Task(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(_)))) => Ok(()),
            reply => refused(reply),
        }
    }

    /// Does what the slave's end asks for. Returns whether to go on.
    pub fn obey(&mut self, session: &mut BoardSession, model: &RobotModel) -> bool {
        let order = self.shared.lock().order;
        if order == Order::Enable && self.state == State::Off {
            let answer = self.enable(session).map_err(|failure| failure.named(model).at_port(&session.port));
            self.state = State::Enabling;
            return answer.is_ok() & self.answer.send(answer).is_ok();
        }
        order != Order::End
    }

    fn enable(&mut self, session: &mut BoardSession) -> Result<(), Failure> {
        // What has piled up while the operator was asked is old.
        while session.board.next_event(Instant::now())?.is_some() {}
        session.heed_interrupts()?;
        let settings = TaskConfig::Impedance(self.settings);
        let elbow = session.board.enable(settings).and_then(|()| session.board.read_impedance());
        session.ignore_interrupts();
        self.elbow.angle = elbow?.elbow;
        Ok(())
    }

    /// The set-point for a pose of the handle, once it is enabled.
    pub fn tick(
        &mut self,
        tick: u32,
        mode: Mode,
        tip: &IsometryMatrix3<f32>,
    ) -> Result<Option<Request>, String> {
        match (self.state, mode) {
            (State::Off, _) => return Ok(None),
            (State::Enabled, Mode::Disabled) => {
                return Err("another program has disabled its board".to_owned());
            }
            (_, Mode::Disabled) => {}
            _ => self.state = State::Enabled,
        }
        let position = tip.translation.vector;
        let velocity = self.account(tick, &position);
        let mut exchange = self.shared.lock();
        (exchange.master_energy, exchange.master_balance) = (self.port.energy_in(), self.port.balance());
        let [max_distance, _] = self.settings.max_deviation;
        let max_force = self.stiffness.min() * MAX_DISPLACEMENT * max_distance;
        exchange.felt.limit = (exchange.force.norm() > max_force).then_some(max_force);
        self.force = exchange.force.cap_magnitude(max_force);
        // A force that gives back more than has arrived is withheld, however large a damping that takes: it
        // cannot push.
        let withheld = self.force.dot(&velocity) / velocity.norm_squared().max(f32::MIN_POSITIVE);
        let limits = self.limits.with_damping_up_to(withheld);
        self.damping = self.port.damping_force(&limits, exchange.slave_energy, &self.force, &velocity);
        let force = (self.force + self.damping).cap_magnitude(max_force);
        // What is accounted for is what is commanded.
        self.damping = force - self.force;
        exchange.felt.force = force.norm();
        exchange.felt.largest = exchange.felt.largest.max(force.norm());
        drop(exchange);
        let (rest, rotation) = self.follow(position, UnitQuaternion::from_rotation_matrix(&tip.rotation));
        let point = PosePoint {
            position: (rest + force.component_div(&self.stiffness)).into(),
            rotation: rotation.coords.into(),
            velocity: [0.0; 6],
            acceleration: [0.0; 6],
        };
        let target = ImpedanceCommand::SetTarget { point, elbow: self.elbow };
        Ok(Some(Request::Task(TaskCommand::Impedance(target))))
    }

    /// Accounts for the motion since the last telemetry; returns the velocity [m/s].
    fn account(&mut self, tick: u32, position: &Vector3<f32>) -> Vector3<f32> {
        let before = self.before.replace((tick, *position));
        let Some((before, from)) = before else { return Vector3::zeros() };
        let displacement = position - from;
        self.port.account(&self.force, &self.damping, &displacement);
        match tick.wrapping_sub(before) {
            0 => Vector3::zeros(),
            #[expect(clippy::cast_precision_loss, reason = "a few ticks")]
            ticks => displacement / (ticks as f32 * TICK),
        }
    }

    /// The set-point without a force: follows the handle outside of the dead band.
    fn follow(
        &mut self,
        position: Vector3<f32>,
        rotation: UnitQuaternion<f32>,
    ) -> (Vector3<f32>, UnitQuaternion<f32>) {
        let (rest, turned) = self.rest.unwrap_or((position, rotation));
        let [distance, angle] = DEAD_BAND;
        let off = (turned * rotation.inverse()).scaled_axis().cap_magnitude(angle);
        let rest = position + (rest - position).cap_magnitude(distance);
        *self.rest.insert((rest, UnitQuaternion::new(off) * rotation))
    }

    /// Switches the master off. A board in fault is left to the reaction of its model: disabled, an arm that
    /// it holds would fall.
    pub fn end(&mut self, session: &mut BoardSession) {
        if self.state == State::Off {
            return;
        }
        session.board.set_timeout(FAREWELL / 4);
        if !session.board.status().is_ok_and(|status| status.node.mode == Mode::Fault) {
            // Without an answer its command timeout does it.
            let _ = session.board.disable();
        }
    }
}
