//! What carries datagrams from one end of a line to the other, and UDP, which is one such thing.

use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::LineError;

/// What carries datagrams between one end of a line and the other.
///
/// It may lose them, double them, delay them, swap them, and bring what a stranger said: the ends above it take only what is of
/// their session and newer than all before. It never blocks in [`send`](Carrier::send): a datagram that has to wait is late anyway.
///
/// One thread receives and waits; any may send.
///
/// ```
/// use std::net::SocketAddr;
/// use std::time::Duration;
///
/// use sortie_line::Carrier;
///
/// /// A line that is cut.
/// struct Cut;
///
/// impl Carrier for Cut {
///     fn send(&self, _: &[u8], _: Option<SocketAddr>) {}
///
///     fn receive(&self, _: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
///         None
///     }
///
///     fn wait(&self, most: Duration) {
///         std::thread::sleep(most);
///     }
///
///     fn address(&self) -> String {
///         "nowhere".to_owned()
///     }
/// }
/// # assert_eq!(Cut.receive(&mut [0; 8]), None);
/// ```
pub trait Carrier: Send + Sync {
    /// Sends a datagram: to where another one came from, or, where that is not said, to the other end. What cannot be sent is
    /// lost, as on the way.
    fn send(&self, datagram: &[u8], to: Option<SocketAddr>);

    /// Puts the next datagram that has come into `room`, without waiting for one. Returns its length and where it came from, as
    /// far as the carrier tells places apart.
    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)>;

    /// Waits until a datagram comes, at most this long, counted in nanoseconds; may return at any time.
    fn wait(&self, most: Duration);

    /// Where it goes, or where it listens, in words for a person.
    fn address(&self) -> String;

    /// The time by which an end counts how long nobody was heard.
    fn now(&self) -> Instant {
        Instant::now()
    }

    /// Takes `hear`, and calls it with all that comes from now on in place of having it received, where it has a thread to do so.
    /// As it stands it has none, and gives `hear` back.
    fn call(&self, hear: Hear) -> Result<(), Hear> {
        Err(hear)
    }
}

/// What is called with a datagram and where it came from.
pub type Hear = Box<dyn Fn(&[u8], Option<SocketAddr>) + Send + Sync>;

/// A socket of UDP.
#[derive(Debug)]
pub struct Udp {
    socket: UdpSocket,
    address: SocketAddr,
}

impl Udp {
    /// That of a team, which listens at this address.
    ///
    /// # Errors
    /// The address cannot be listened at.
    pub fn listen(address: SocketAddr) -> Result<Self, LineError> {
        Self::open(address, || UdpSocket::bind(address))
    }

    /// That of a runner, to the team that listens at this address.
    ///
    /// # Errors
    /// There is no way to it.
    pub fn connect(address: SocketAddr) -> Result<Self, LineError> {
        let any: SocketAddr = match address {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        Self::open(address, || {
            let socket = UdpSocket::bind(any)?;
            socket.connect(address)?;
            Ok(socket)
        })
    }

    fn open(
        address: SocketAddr,
        open: impl FnOnce() -> io::Result<UdpSocket>,
    ) -> Result<Self, LineError> {
        let opened = open().and_then(|socket| socket.set_nonblocking(true).map(|()| socket));
        let failed = |source| LineError::Carrier { address: address.to_string(), source };
        Ok(Self { socket: opened.map_err(failed)?, address })
    }

    /// This end's own address, with the port that the system chose where none was named.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn own_address(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}

impl Carrier for Udp {
    fn send(&self, datagram: &[u8], to: Option<SocketAddr>) {
        let _ = match to {
            Some(to) => self.socket.send_to(datagram, to),
            None => self.socket.send(datagram),
        };
    }

    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
        loop {
            match self.socket.recv_from(room) {
                Ok((len, from)) => return Some((len, Some(from))),
                // Nobody listened there when the last one came: that may change.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => return None,
            }
        }
    }

    /// Timeouts of sockets count ticks of the kernel: those of `poll` are nanoseconds.
    fn wait(&self, most: Duration) {
        // A wait of longer than a year ends after one.
        let seconds = most.as_secs().min(31_536_000) as i64;
        let most = Timespec { tv_sec: seconds, tv_nsec: most.subsec_nanos().into() };
        // Woken or not, the socket is looked at.
        let _ = poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&most));
    }

    fn address(&self) -> String {
        self.address.to_string()
    }
}
