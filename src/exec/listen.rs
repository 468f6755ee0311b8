//! Splits what a stage prints: lines that are messages go to the engine, everything else goes to its log.

use std::io::{self, Read, Write};

use dril_stage_api::Message;

use crate::fsx::File;

/// A longer line is not a message; it is passed on in parts, so that no stage can fill the engine's memory.
const LONGEST_LINE: usize = 64 * 1024;

/// Splits the output of a stage.
pub(super) struct Listener<L = File> {
    log: L,
    line: Vec<u8>,
    failure: Option<String>,
    /// Why the log is incomplete.
    lost: Option<io::Error>,
}

impl<L: Write> Listener<L> {
    pub fn new(log: L) -> Self {
        Self { log, line: Vec::new(), failure: None, lost: None }
    }

    /// Processes what one `read` returns; false at the end.
    pub fn read(
        &mut self,
        output: Option<&mut impl Read>,
        on_message: &mut dyn FnMut(Message),
    ) -> io::Result<bool> {
        let mut buffer = [0; 8192];
        let count = match output.map(|output| output.read(&mut buffer)) {
            Some(Err(error)) if error.kind() == io::ErrorKind::Interrupted => return Ok(true),
            Some(result) => result?,
            None => 0,
        };
        self.take(&buffer[..count], on_message)?;
        Ok(count > 0)
    }

    /// Processes the rest, which has no line end.
    pub fn finish(&mut self, on_message: &mut dyn FnMut(Message)) -> io::Result<()> {
        if self.line.is_empty() { Ok(()) } else { self.end_line(on_message) }
    }

    /// Why the log is incomplete, most likely because the disk is full. The stage continues: its log is not a result.
    pub fn lost(&self) -> Option<&io::Error> {
        self.lost.as_ref()
    }

    /// The error that the stage reported.
    pub fn failure(&self) -> Option<String> {
        self.failure.clone()
    }

    fn take(&mut self, bytes: &[u8], on_message: &mut dyn FnMut(Message)) -> io::Result<()> {
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            let (text, ended) = match piece.split_last() {
                Some((b'\n', text)) => (text, true),
                _ => (piece, false),
            };
            self.line.extend_from_slice(text);
            if ended || self.line.len() > LONGEST_LINE {
                self.end_line(on_message)?;
            }
        }
        Ok(())
    }

    fn end_line(&mut self, on_message: &mut dyn FnMut(Message)) -> io::Result<()> {
        let message = std::str::from_utf8(&self.line).ok().and_then(Message::from_line);
        match message {
            Some(Message::Failed { error }) => self.failure = Some(error),
            Some(message) => on_message(message),
            None => {
                self.line.push(b'\n');
                if let Err(error) = self.log.write_all(&self.line) {
                    self.lost.get_or_insert(error);
                }
            }
        }
        self.line.clear();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listen(parts: &[&[u8]]) -> (Vec<Message>, Vec<u8>, Option<String>) {
        let mut listener = Listener::new(Vec::new());
        let mut heard = Vec::new();
        for part in parts {
            listener.take(part, &mut |message| heard.push(message)).unwrap();
        }
        listener.finish(&mut |message| heard.push(message)).unwrap();
        (heard, listener.log, listener.failure)
    }

    #[test]
    fn messages_are_recognised_and_the_rest_is_logged_however_the_bytes_arrive() {
        let message = Message::Progress(dril_stage_api::Progress { step: 1, total: 2, ..Default::default() });
        let mut text = format!("[W] a warning\n{}\n{{not json\n", message.to_line()).into_bytes();
        text.push(0xff);
        let expected = listen(&[&text]);
        assert_eq!(expected.0, [message]);
        assert_eq!(expected.1, b"[W] a warning\n{not json\n\xff\n");
        for cut in 1..text.len() {
            assert_eq!(listen(&[&text[..cut], &text[cut..]]), expected, "cut at {cut}");
        }
    }

    #[test]
    fn the_error_that_a_stage_reports_is_its_failure() {
        let line = Message::Failed { error: "no demonstrations".into() }.to_line();
        assert_eq!(listen(&[line.as_bytes()]).2.as_deref(), Some("no demonstrations"));
    }

    #[test]
    fn a_log_that_cannot_be_written_is_reported_and_ends_no_stage() {
        struct Full;
        impl Write for Full {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::StorageFull.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let mut listener = Listener::new(Full);
        let message = Message::Progress(dril_stage_api::Progress { step: 1, total: 2, ..Default::default() });
        let mut heard = Vec::new();
        let text = format!("lost\n{}\n", message.to_line());
        listener.take(text.as_bytes(), &mut |message| heard.push(message)).unwrap();
        assert_eq!(heard, [message]);
        assert_eq!(listener.lost().unwrap().kind(), io::ErrorKind::StorageFull);
    }

    #[test]
    fn an_endless_line_does_not_fill_memory() {
        let mut listener = Listener::new(Vec::new());
        for _ in 0..64 {
            listener.take(&[b'x'; 4096], &mut |_| {}).unwrap();
            assert!(listener.line.len() <= LONGEST_LINE + 4096);
        }
        assert!(listener.log.len() >= 2 * LONGEST_LINE);
    }
}
