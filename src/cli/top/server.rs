//! A page about a team that renews itself, and what Prometheus reads, over HTTP: a request at a time, and nothing can be changed.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use super::overview::Overview;
use super::{lines, metrics};
use crate::failure::{Exit, Failure};

/// A request is read and answered in this time, or not at all: the next one waits for it.
const PATIENCE: Duration = Duration::from_secs(1);
/// The first line of a request and its headers are no longer.
const REQUEST_BYTES: usize = 8192;

/// The numbers that are served; whoever listens puts newer ones in their place.
pub(super) type Shared = Arc<Mutex<Overview>>;

/// Where to serve: a port of this machine alone, or an address that says who else may ask.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    let own = text.parse().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    own.or_else(|_| text.parse()).map_err(|_| {
        "expected a port, as 9100, or an address with one, as 127.0.0.1:9100".to_owned()
    })
}

/// Begins to serve, as long as this process lives; returns where.
pub(super) fn serve(address: SocketAddr, team: Shared) -> Result<SocketAddr, Failure> {
    let failed = |error: io::Error| {
        let exit = match error.kind() {
            io::ErrorKind::AddrInUse => Exit::Busy,
            io::ErrorKind::PermissionDenied => Exit::NotPermitted,
            _ => Exit::InputOutput,
        };
        Failure::new(exit, format!("{address}: {error}; name another one: --serve ADDRESS:PORT"))
    };
    let listener = TcpListener::bind(address).map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    let answer = move || {
        for stream in listener.incoming().flatten() {
            // Who asks may be gone, or want nothing that is here: the next one is served all the same.
            let _ = answer(stream, &team);
        }
    };
    thread::Builder::new().spawn(answer).map_err(failed)?;
    Ok(bound)
}

fn answer(mut stream: TcpStream, team: &Shared) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let request = read(&mut stream)?;
    let mut words = request.split(' ');
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let path = path.split('?').next().unwrap_or_default();
    let team = || team.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let (status, media_type, body) = match (method, path) {
        ("GET", "/") => ("200 OK", "text/html; charset=utf-8", page(&team())),
        ("GET", "/metrics") => ("200 OK", metrics::MEDIA_TYPE, metrics::text(&team())),
        ("GET", _) => ("404 Not Found", "text/plain", "there are / and /metrics\n".to_owned()),
        _ => ("405 Method Not Allowed", "text/plain", "this can be read alone\n".to_owned()),
    };
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {media_type}\r\nContent-Length: {length}\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n\r\n{body}"
    )?;
    stream.flush()
}

/// The head of a request.
fn read(stream: &mut TcpStream) -> io::Result<String> {
    let (mut request, mut piece) = (Vec::new(), [0; 1024]);
    // What is not read before the end would reset the connection under the answer.
    while !request.windows(4).any(|end| end == b"\r\n\r\n") && request.len() < REQUEST_BYTES {
        let count = stream.read(&mut piece)?;
        if count == 0 {
            break;
        }
        request.extend(piece.iter().take(count));
    }
    Ok(String::from_utf8_lossy(&request).into_owned())
}

/// The lines of the terminal, which the browser asks for anew every second.
fn page(team: &Overview) -> String {
    let text = lines::all(team).join("\n");
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    let title = team.domain.replace('&', "&amp;").replace('<', "&lt;");
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><meta charset=\"utf-8\"><meta http-equiv=\"refresh\" content=\"1\">\
         <meta name=\"color-scheme\" content=\"light dark\"><title>{title}</title>\n<pre>{text}</pre>\n\
         <p><a href=\"/metrics\">metrics</a></html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_an_address_only_this_machine_may_ask() {
        assert_eq!(address("9100"), Ok("127.0.0.1:9100".parse().expect("an address")));
        assert_eq!(address("0.0.0.0:80"), Ok("0.0.0.0:80".parse().expect("an address")));
        assert!(address("north").is_err() && address("70000").is_err());
    }
}
