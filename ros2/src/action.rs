//! The server of an action: its three services and two topics
//! (<https://design.ros2.org/articles/actions.html>). It keeps the states of goals; the caller carries them
//! out.

use crate::dds::{Dds, DdsError, Writer, dds_type, encode, qos};
use crate::messages::{
    CancelGoalRequest, CancelGoalResponse, ErrorCode, Feedback, GetResultRequest, GetResultResponse, Goal,
    GoalInfo, GoalStatus, GoalStatusArray, SendGoalRequest, SendGoalResponse, Status, Time, Uuid,
};
use crate::service::{Caller, Service};

/// Its type.
const ACTION: &str = "control_msgs/action/FollowJointTrajectory";
/// Maximum number of ended goals that are kept, with their results.
const MAX_ENDED: usize = 50;
/// Maximum number of clients that may wait for results.
const MAX_WAITING: usize = 200;

/// A goal that was accepted.
#[derive(Clone, Debug)]
struct Known {
    info: GoalInfo,
    status: Status,
    /// Its result, once it has ended.
    result: Option<(ErrorCode, String)>,
}

/// A request of a client.
pub enum Wish {
    /// Carry out a goal: to be [accepted](ActionServer::accept) or [refused](ActionServer::refuse).
    Goal(Caller, Uuid, Box<Goal>),
    /// Cancel these goals.
    Cancel(Vec<Uuid>),
}

/// The action `…/follow_joint_trajectory` of a controller.
pub struct ActionServer {
    send_goal: Service,
    cancel_goal: Service,
    get_result: Service,
    feedback: Writer,
    status: Writer,
    /// Goals in the order in which they were accepted.
    goals: Vec<Known>,
    /// Callers that wait for the result of a goal.
    waiting: Vec<(Caller, Uuid)>,
}

impl ActionServer {
    /// Offers the action called `name`.
    pub fn offer(dds: &Dds, name: &str) -> Result<Self, DdsError> {
        let service = |part: &str, kind: &str| Service::offer(dds, &format!("{name}/_action/{part}"), kind);
        let topic = |part: &str, kind: &str, depth, transient_local| {
            dds.writer(&format!("rt{name}/_action/{part}"), &dds_type(kind), &qos(depth, transient_local))
        };
        let server = Self {
            send_goal: service("send_goal", &format!("{ACTION}_SendGoal"))?,
            cancel_goal: service("cancel_goal", "action_msgs/srv/CancelGoal")?,
            get_result: service("get_result", &format!("{ACTION}_GetResult"))?,
            feedback: topic("feedback", &format!("{ACTION}_FeedbackMessage"), 10, false)?,
            status: topic("status", "action_msgs/msg/GoalStatusArray", 1, true)?,
            goals: Vec::new(),
            waiting: Vec::new(),
        };
        server.publish_status();
        Ok(server)
    }

    /// Returns the next request of a client. Goals come first, because a request to cancel, or for a result,
    /// may refer to a goal that came just before.
    pub fn take(&mut self) -> Option<Wish> {
        if let Some((caller, request)) = self.send_goal.take::<SendGoalRequest>() {
            return Some(Wish::Goal(caller, request.goal_id, Box::new(request.goal)));
        }
        if let Some((caller, request)) = self.cancel_goal.take::<CancelGoalRequest>() {
            return Some(Wish::Cancel(self.cancel(caller, &request.goal_info)));
        }
        while let Some((caller, request)) = self.get_result.take::<GetResultRequest>() {
            match self.goals.iter().find(|goal| goal.info.goal_id == request.goal_id) {
                Some(Known { result: None, .. }) if self.waiting.len() < MAX_WAITING => {
                    self.waiting.push((caller, request.goal_id));
                }
                known => {
                    let response = result(known);
                    self.get_result.reply(caller, &response);
                }
            }
        }
        None
    }

    /// Returns whether there already is such a goal.
    pub fn knows(&self, id: &Uuid) -> bool {
        self.goals.iter().any(|goal| goal.info.goal_id == *id)
    }

    /// Accepts a goal, which is carried out from now on.
    pub fn accept(&mut self, caller: Caller, id: Uuid) {
        let stamp = Time::now();
        let info = GoalInfo { goal_id: id, stamp };
        self.goals.push(Known { info, status: Status::Executing, result: None });
        let ended = self.goals.iter().filter(|goal| goal.result.is_some()).count();
        if ended > MAX_ENDED
            && let Some(oldest) = self.goals.iter().position(|goal| goal.result.is_some())
        {
            self.goals.remove(oldest);
        }
        self.publish_status();
        self.send_goal.reply(caller, &SendGoalResponse { accepted: true, stamp });
    }

    /// Refuses a goal.
    pub fn refuse(&mut self, caller: Caller) {
        self.send_goal.reply(caller, &SendGoalResponse { accepted: false, stamp: Time::now() });
    }

    /// Refuses the goals that wait. Returns whether there were any.
    pub fn refuse_waiting(&mut self) -> bool {
        let mut any = false;
        while let Some((caller, _)) = self.send_goal.take::<SendGoalRequest>() {
            self.refuse(caller);
            any = true;
        }
        any
    }

    /// Ends a goal with its result.
    pub fn end(&mut self, id: &Uuid, status: Status, code: ErrorCode, text: &str) {
        let Some(goal) = self.goals.iter_mut().find(|goal| goal.info.goal_id == *id) else { return };
        (goal.status, goal.result) = (status, Some((code, text.to_owned())));
        let response = result(Some(goal));
        self.publish_status();
        for (caller, waiting) in std::mem::take(&mut self.waiting) {
            if waiting == *id {
                self.get_result.reply(caller, &response);
            } else {
                self.waiting.push((caller, waiting));
            }
        }
    }

    /// Publishes the progress of the goal.
    pub fn feed_back(&self, feedback: &Feedback) {
        // If it fails, the next feedback follows soon.
        let _ = self.feedback.write(encode(feedback), None);
    }

    /// Returns whether every answer has been sent.
    pub fn is_idle(&mut self) -> bool {
        [&mut self.send_goal, &mut self.cancel_goal, &mut self.get_result]
            .into_iter()
            .all(|service| service.is_idle())
    }

    /// Handles a request to cancel all goals, one of them, or all that are not newer than a stamp.
    fn cancel(&mut self, caller: Caller, request: &GoalInfo) -> Vec<Uuid> {
        let (id, stamp) = (request.goal_id, request.stamp);
        let any = id == Uuid::default();
        let by_time = stamp != Time::default();
        let mut goals_canceling = Vec::new();
        for goal in self.goals.iter_mut().filter(|goal| goal.status == Status::Executing) {
            let is_meant = if any { !by_time } else { goal.info.goal_id == id };
            if is_meant || (by_time && goal.info.stamp <= stamp) {
                goal.status = Status::Canceling;
                goals_canceling.push(goal.info);
            }
        }
        let known = self.goals.iter().find(|goal| goal.info.goal_id == id);
        let return_code = match known {
            _ if !goals_canceling.is_empty() || any => CancelGoalResponse::NONE,
            None => CancelGoalResponse::UNKNOWN_GOAL_ID,
            Some(_) => CancelGoalResponse::GOAL_TERMINATED,
        };
        let ids = goals_canceling.iter().map(|info| info.goal_id).collect();
        self.publish_status();
        self.cancel_goal.reply(caller, &CancelGoalResponse { return_code, goals_canceling });
        ids
    }

    fn publish_status(&self) {
        let status = |goal: &Known| GoalStatus { goal_info: goal.info, status: goal.status };
        let message = GoalStatusArray { status_list: self.goals.iter().map(status).collect() };
        // The last message is also kept for late subscribers.
        let _ = self.status.write(encode(&message), None);
    }
}

/// Returns the response to a request for the result of a goal.
fn result(goal: Option<&Known>) -> GetResultResponse {
    match goal {
        Some(Known { status, result: Some((code, text)), .. }) => {
            GetResultResponse { status: *status, error_code: *code, error_string: text.clone() }
        }
        Some(_) => GetResultResponse {
            status: Status::Unknown,
            error_code: ErrorCode::InvalidGoal,
            error_string: "too many wait for results".to_owned(),
        },
        None => GetResultResponse {
            status: Status::Unknown,
            error_code: ErrorCode::InvalidGoal,
            error_string: "there is no such goal, or it ended too long ago".to_owned(),
        },
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn all_goals_that_are_cancelled_include_one_that_came_just_before() {
        let _alone = crate::dds::tests::alone();
        let (here, there) = (Dds::open(232, None).unwrap(), Dds::open(232, None).unwrap());
        let mut server = ActionServer::offer(&here, "/test").unwrap();
        let writer = |part: &str, kind: &str| {
            let name = format!("rq/test/_action/{part}Request");
            there.writer(&name, &dds_type(&format!("{kind}_Request")), &qos(10, false)).unwrap()
        };
        let goals = writer("send_goal", &format!("{ACTION}_SendGoal"));
        let cancels = writer("cancel_goal", "action_msgs/srv/CancelGoal");
        // More rounds than are ever needed.
        for round in 1..100 {
            let id = [round; 16];
            goals.write(encode(&SendGoalRequest { goal_id: id, goal: Goal::default() }), None).unwrap();
            std::thread::sleep(Duration::from_millis(200));
            // Cancels all goals.
            let all = GoalInfo { goal_id: Uuid::default(), stamp: Time::default() };
            cancels.write(encode(&all), None).unwrap();
            std::thread::sleep(Duration::from_millis(200));
            let (mut accepted, mut cancelled) = (Vec::new(), None);
            while let Some(wish) = server.take() {
                match wish {
                    Wish::Goal(caller, id, _) => {
                        server.accept(caller, id);
                        accepted.push(id);
                    }
                    Wish::Cancel(ids) => cancelled = Some(ids),
                }
            }
            // Requests are lost until both ends have discovered each other.
            if let Some(cancelled) = cancelled.filter(|_| accepted.contains(&id)) {
                assert_eq!(cancelled, accepted);
                return;
            }
        }
        panic!("no request has come");
    }
}
