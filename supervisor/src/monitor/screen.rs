use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event;
use ratatui::style::Color;

use super::{Key, View, draw, draw_faults, draw_help};

/// A panel over the view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Overlay {
    /// The keys and signs.
    Help,
    /// All faults.
    Faults,
}

/// The terminal in the alternate screen, without echo, and with unbuffered keys. It is restored when this is
/// dropped, and before the message of a panic.
#[derive(Debug)]
pub struct Screen {
    terminal: DefaultTerminal,
    colours: bool,
}

impl Screen {
    /// Takes the terminal over. There are no colours if the environment has a non-empty `NO_COLOR`.
    ///
    /// # Errors
    /// Standard output is not a terminal, or one that does not support this.
    pub fn enter() -> io::Result<Self> {
        if !io::stdout().is_terminal() {
            return Err(io::Error::other("the monitor needs a terminal to draw on"));
        }
        let colours = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
        match ratatui::try_init() {
            Ok(terminal) => Ok(Self { terminal, colours }),
            Err(error) => {
                // The mode may already be half entered; the first error is the one to report.
                let _ = ratatui::try_restore();
                Err(error)
            }
        }
    }

    /// Shows `view`, with `overlay` over it.
    ///
    /// # Errors
    /// The terminal is gone.
    pub fn draw(&mut self, view: &View, selected: Option<usize>, overlay: Option<Overlay>) -> io::Result<()> {
        let colours = self.colours;
        self.terminal.draw(|frame| {
            draw(frame, view, selected);
            match overlay {
                Some(Overlay::Help) => draw_help(frame),
                Some(Overlay::Faults) => draw_faults(frame, view),
                None => {}
            }
            if !colours {
                drop_colours(frame.buffer_mut());
            }
        })?;
        Ok(())
    }

    /// Waits for a known key, for at most `timeout`. A change of the terminal's size ends the wait early,
    /// with `None`, so that it is redrawn.
    ///
    /// # Errors
    /// The terminal is gone.
    pub fn key(&mut self, timeout: Duration) -> io::Result<Option<Key>> {
        let deadline = Instant::now() + timeout;
        while event::poll(deadline.saturating_duration_since(Instant::now()))? {
            let event = event::read()?;
            let key = Key::from_event(&event);
            if key.is_some() || matches!(event, event::Event::Resize(..)) {
                return Ok(key);
            }
        }
        Ok(None)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // Errors can no longer be reported.
        let _ = self.terminal.show_cursor();
        // In a panic the hook has done this, and a second restore would put the cursor over the message.
        if !std::thread::panicking() {
            let _ = ratatui::try_restore();
        }
    }
}

/// Keeps only what a terminal without colours shows: characters, bold, dim and reversed.
pub(super) fn drop_colours(buffer: &mut Buffer) {
    for cell in &mut buffer.content {
        cell.fg = Color::Reset;
        cell.bg = Color::Reset;
    }
}
