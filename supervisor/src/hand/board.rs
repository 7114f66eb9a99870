use std::time::Instant;

use tesaki::protocol::{FromBoard, Mode, Refusal, Reply, ReplyFrame, Request, Telemetry, Tips};

use crate::{Board, BoardError, ByteLink, LinkBoard};

/// What came from a board since it was listened to last: the latest of each.
#[derive(Clone, Debug, Default)]
pub struct News {
    /// Its joints.
    pub telemetry: Option<Telemetry>,
    /// Its fingertip.
    pub tips: Option<Tips>,
    /// Why it did not take a set-point.
    pub refusal: Option<Refusal>,
}

/// A board that can be spoken to without waiting for its answer.
pub trait FingerBoard: Board {
    /// Sends a request; that it was refused comes as [`News`].
    ///
    /// # Errors
    /// When the link fails.
    fn post(&mut self, request: Request) -> Result<(), BoardError>;

    /// Takes what has come.
    ///
    /// # Errors
    /// When the link fails.
    fn listen(&mut self) -> Result<News, BoardError>;
}

impl<L: ByteLink> FingerBoard for LinkBoard<L> {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        Self::post(self, request).map(|_| ())
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        let mut news = News::default();
        while let Some(event) = self.next_event(Instant::now())? {
            news.take(event);
        }
        Ok(news)
    }
}

impl News {
    /// Takes in what came unasked.
    pub fn take(&mut self, event: FromBoard) {
        match event {
            FromBoard::Telemetry(telemetry) => self.telemetry = Some(telemetry),
            FromBoard::Tips(tips) => self.tips = Some(tips),
            FromBoard::Reply(ReplyFrame { reply: Reply::Refused(refusal), .. }) => self.refuse(refusal),
            _ => {}
        }
    }

    /// Takes in a refusal that matters: one of a set-point that came late, or twice, does not, and a fault
    /// shows in the telemetry.
    pub fn refuse(&mut self, refusal: Refusal) {
        if !matches!(refusal, Refusal::Stale { .. } | Refusal::WrongMode(Mode::Fault | Mode::Disabled)) {
            self.refusal = Some(refusal);
        }
    }
}
