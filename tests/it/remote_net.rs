//! Networks for the tests of shared caches: a plain HTTP server over a folder, and a proxy before a real server. Both can
//! be made to lose, cut and delay what passes through them.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Numbers that look random: the same ones in every run.
#[derive(Debug, Default)]
pub struct Dice(AtomicU64);

impl Dice {
    /// The next number below `sides`.
    pub fn below(&self, sides: u64) -> u64 {
        let mut x = self.0.fetch_add(0x9e37_79b9_7f4a_7c15, Ordering::Relaxed);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (x ^ (x >> 31)) % sides
    }
}

/// A server on a port of its own that runs until the test ends.
pub struct Net {
    pub address: SocketAddr,
    /// One in so many requests or connections goes wrong; 0: none.
    pub faults: Arc<AtomicU64>,
    /// Requests or connections so far.
    pub count: Arc<AtomicU64>,
}

impl Net {
    fn start(serve: impl Fn(TcpStream, u64, &Dice) + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let (faults, count) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let net = Self { address, faults: Arc::clone(&faults), count: Arc::clone(&count) };
        let shared = Arc::new((serve, Dice::default()));
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                count.fetch_add(1, Ordering::Relaxed);
                let (shared, faults) = (Arc::clone(&shared), faults.load(Ordering::Relaxed));
                std::thread::spawn(move || shared.0(stream, faults, &shared.1));
            }
        });
        net
    }

    /// Serves the files of a folder over HTTP, one request for each connection.
    pub fn files(folder: &Path) -> Self {
        let folder = folder.to_owned();
        Self::start(move |stream, faults, dice| drop(serve_file(&folder, stream, faults, dice)))
    }

    /// Passes connections on to a server.
    pub fn proxy(server: SocketAddr) -> Self {
        Self::start(move |stream, faults, dice| drop(pass_on(server, stream, faults, dice)))
    }
}

fn serve_file(folder: &Path, stream: TcpStream, faults: u64, dice: &Dice) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut request = String::new();
    reader.read_line(&mut request)?;
    let mut line = String::new();
    while reader.read_line(&mut line)? > 2 {
        line.clear();
    }
    let path: PathBuf =
        request.split(' ').nth(1).unwrap_or("/").split('/').filter(|part| *part != "..").collect();
    let mut stream = reader.into_inner();
    let wrong = if faults > 0 && dice.below(faults) == 0 { dice.below(5) } else { 9 };
    let body = match std::fs::read(folder.join(path)) {
        _ if wrong == 0 => return Ok(()),
        _ if wrong == 1 => {
            let answer = "HTTP/1.1 503 Slow Down\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
            return stream.write_all(answer.as_bytes());
        }
        Ok(body) => body,
        Err(_) => {
            let answer = "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
            return stream.write_all(answer.as_bytes());
        }
    };
    // 2: cut, and it shows; 3: cut in silence, as servers do that send no length; 4: slow.
    let length = if wrong == 3 { String::new() } else { format!("Content-Length: {}\r\n", body.len()) };
    stream.write_all(format!("HTTP/1.1 200 OK\r\n{length}Connection: close\r\n\r\n").as_bytes())?;
    let end = if wrong == 2 || wrong == 3 { body.len() / 2 } else { body.len() };
    if wrong == 4 {
        std::thread::sleep(Duration::from_millis(50));
    }
    stream.write_all(&body[..end])?;
    stream.shutdown(Shutdown::Both)
}

/// Copies bytes both ways; a connection that goes wrong is refused, or cut after some bytes, or begins late.
fn pass_on(server: SocketAddr, client: TcpStream, faults: u64, dice: &Dice) -> std::io::Result<()> {
    let wrong = if faults > 0 && dice.below(faults) == 0 { dice.below(4) } else { 9 };
    if wrong == 0 {
        return Ok(());
    }
    if wrong == 1 {
        std::thread::sleep(Duration::from_millis(dice.below(200)));
    }
    let server = TcpStream::connect(server)?;
    let cut = |side| if wrong == side { dice.below(40_000) } else { u64::MAX };
    let (up, down) = (cut(2), cut(3));
    let (from_client, to_server) = (client.try_clone()?, server.try_clone()?);
    std::thread::spawn(move || copy(from_client, to_server, up));
    copy(server, client, down);
    Ok(())
}

fn copy(mut from: TcpStream, mut to: TcpStream, limit: u64) {
    let _ = std::io::copy(&mut (&mut from).take(limit), &mut to);
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}
