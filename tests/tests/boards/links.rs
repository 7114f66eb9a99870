//! Boards behind cables that can be cut, and behind wires that lose telemetry.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;
use std::time::{Duration, Instant};

use tesaki::protocol::{ActuatorFrame, Reply, Request, SensorFrame};
use tesaki_sim::controller::Controller;
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::hand::{FingerBoard, News};
use tesaki_supervisor::{Board, BoardError, ByteLink, LinkBoard};

/// A board at a cable that can be cut, with the last command to its drives.
pub struct Cable<B> {
    pub board: B,
    pub cut: bool,
    /// Whether the link fails when the board is first listened to after it was enabled.
    pub breaks: bool,
    was_enabled: bool,
    pub actuators: ActuatorFrame,
}

impl<B> Cable<B> {
    pub fn new(board: B) -> Self {
        Self { board, cut: false, breaks: false, was_enabled: false, actuators: ActuatorFrame::default() }
    }
}

impl<B: Board> Board for Cable<B> {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.was_enabled = matches!(request, Request::Enable(_));
        if self.cut { Err(BoardError::Timeout { seconds: 2.0 }) } else { self.board.request(request) }
    }
}

impl<B: FingerBoard> FingerBoard for Cable<B> {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        if self.cut { Ok(()) } else { self.board.post(request) }
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        if self.breaks && std::mem::take(&mut self.was_enabled) {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
        }
        if self.cut { Ok(News::default()) } else { self.board.listen() }
    }
}

impl<B: Controller> Controller for Cable<B> {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        self.actuators = self.board.tick(sensors)?;
        Ok(self.actuators.clone())
    }
}

/// Bytes to and from a board in this process.
#[derive(Default)]
struct Wire {
    pub board: VirtualBoard,
    from_board: Vec<u8>,
}

/// The PC's end of a wire.
#[derive(Clone, Default)]
struct End(Rc<RefCell<Wire>>);

impl ByteLink for End {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Wire { board, from_board } = &mut *self.0.borrow_mut();
        board.receive(bytes, from_board);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], _: Instant) -> io::Result<usize> {
        let from_board = &mut self.0.borrow_mut().from_board;
        let length = from_board.len().min(buffer.len());
        buffer[..length].copy_from_slice(&from_board[..length]);
        from_board.drain(..length);
        Ok(length)
    }
}

/// A board that is accessed as over a serial line, which loses the received bytes in some ticks.
pub struct Wired {
    link: LinkBoard<End>,
    end: End,
    /// Interval of the lost ticks; 0 for none.
    lossy: u32,
}

impl Wired {
    pub fn new(lossy: u32) -> Self {
        let end = End::default();
        Self { link: LinkBoard::new(end.clone(), Duration::from_secs(2)), end, lossy }
    }
}

impl Board for Wired {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.link.request(request)
    }
}

impl FingerBoard for Wired {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        FingerBoard::post(&mut self.link, request)
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        self.link.listen()
    }
}

impl Controller for Wired {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        let Wire { board, from_board } = &mut *self.end.0.borrow_mut();
        let before = from_board.len();
        let actuators = board.tick(sensors, from_board);
        if sensors.sequence.checked_rem(self.lossy) == Some(0) {
            from_board.truncate(before);
        }
        Ok(actuators)
    }
}
