use std::time::Instant;

use tesaki::protocol::{FromBoard, Mode, Refusal, Reply, ReplyFrame, Request, Telemetry, Tips};

use crate::{Board, BoardError, ByteLink, LinkBoard};

/// Data received from a board since the last call: the latest of each kind.
#[derive(Clone, Debug, Default)]
pub struct News {
    /// Its joints.
    pub telemetry: Option<Telemetry>,
    /// Its fingertip.
    pub tips: Option<Tips>,
    /// Why it refused a set-point.
    pub refusal: Option<Refusal>,
}

/// A board that takes requests without waiting for replies.
pub trait FingerBoard: Board {
    /// Sends a request; a refusal comes later, in [`News`].
    ///
    /// # Errors
    /// When the link fails.
    fn post(&mut self, request: Request) -> Result<(), BoardError>;

    /// Returns the data received so far.
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
    /// Stores a message.
    pub fn take(&mut self, event: FromBoard) {
        match event {
            FromBoard::Telemetry(telemetry) => self.telemetry = Some(telemetry),
            FromBoard::Tips(tips) => self.tips = Some(tips),
            FromBoard::Reply(ReplyFrame { reply: Reply::Refused(refusal), .. }) => self.refuse(refusal),
            _ => {}
        }
    }

    /// Stores a refusal, unless the set-point was late or duplicated; a fault shows in the telemetry.
    pub fn refuse(&mut self, refusal: Refusal) {
        if !matches!(refusal, Refusal::Stale { .. } | Refusal::WrongMode(Mode::Fault | Mode::Disabled)) {
            self.refusal = Some(refusal);
        }
    }
}
