//! The connection to Haply's service.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use tungstenite::{Error, Message, WebSocket};

use super::message::{Dialect, force_message, parse_state};
use super::{FORCE_BYTES, inverse3};
use crate::link::{LONGEST_REPORT, Transport, TransportError};
use crate::{DeviceError, HapticDevice};

/// Address at which the service listens.
pub(crate) const ADDRESS: &str = "127.0.0.1:10001";
/// Longest time that connecting to the service may take.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(500);
const REMEDY: &str = "start Haply's Inverse service, and plug the device in";

/// Opens the first Inverse3 of the service at an address.
pub(crate) fn open(address: &str) -> Result<Box<dyn HapticDevice>, DeviceError> {
    let refused = |reason: String| DeviceError::NotOpened {
        device: format!("the Haply service at {address}"),
        reason,
        remedy: REMEDY,
    };
    let place: SocketAddr = address.parse().map_err(|error| refused(format!("{error}")))?;
    let mut first = Some(Connection::open(place).map_err(refused)?);
    let open = move || -> Option<Box<dyn Transport>> {
        Some(Box::new(first.take().or_else(|| Connection::open(place).ok())?))
    };
    let device = inverse3().spawn(open).map_err(|error| refused(error.to_string()))?;
    Ok(Box::new(device))
}

struct Connection {
    socket: WebSocket<TcpStream>,
    dialect: Dialect,
    /// The device's number, once known.
    device: Option<String>,
    timeout: Duration,
}

impl Connection {
    fn open(place: SocketAddr) -> Result<Self, String> {
        let connect = || -> std::io::Result<TcpStream> {
            let stream = TcpStream::connect_timeout(&place, CONNECT_TIMEOUT)?;
            stream.set_read_timeout(Some(CONNECT_TIMEOUT))?;
            stream.set_write_timeout(Some(CONNECT_TIMEOUT))?;
            stream.set_nodelay(true)?;
            Ok(stream)
        };
        let dialect = connect().map_or(Dialect::default(), |stream| asked(stream, place));
        let stream = connect().map_err(|error| error.to_string())?;
        let (socket, _) =
            tungstenite::client(format!("ws://{place}"), stream).map_err(|error| error.to_string())?;
        Ok(Self { socket, dialect, device: None, timeout: CONNECT_TIMEOUT })
    }
}

/// Dialect of the service, from the version that it reports.
fn asked(mut stream: TcpStream, place: SocketAddr) -> Dialect {
    let request = format!("GET /version HTTP/1.1\r\nHost: {place}\r\nConnection: close\r\n\r\n");
    let mut answer = Vec::new();
    if stream.write_all(request.as_bytes()).is_err() {
        return Dialect::default();
    }
    // Everything that comes until the service closes the connection or the time is over.
    let _ = stream.take(1 << 14).read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer);
    let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
    let version: String = body
        .chars()
        .skip_while(|letter| !letter.is_ascii_digit())
        .take_while(|letter| letter.is_ascii_digit() || *letter == '.')
        .collect();
    Dialect::of(&version)
}

impl Connection {
    /// The next message, if one comes in time.
    fn message(&mut self, timeout: Duration) -> Result<Message, Error> {
        if timeout.is_zero() {
            // A timeout of zero would mean none, and a short one is rounded up to some milliseconds.
            self.socket.get_ref().set_nonblocking(true)?;
            let message = self.socket.read();
            self.socket.get_ref().set_nonblocking(false)?;
            return message;
        }
        if timeout != self.timeout {
            self.timeout = timeout;
            self.socket.get_ref().set_read_timeout(Some(timeout))?;
        }
        self.socket.read()
    }
}

impl Transport for Connection {
    fn read(
        &mut self,
        report: &mut [u8; LONGEST_REPORT],
        timeout: Duration,
    ) -> Result<usize, TransportError> {
        let message = match self.message(timeout) {
            Ok(Message::Text(message)) => message,
            Ok(_) => return Ok(0),
            Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                return Ok(0);
            }
            Err(Error::Io(error)) if error.kind() == ErrorKind::Interrupted => {
                return Err(TransportError::Failed);
            }
            Err(_) => return Err(TransportError::Disconnected),
        };
        let Some((device, state)) = parse_state(&message) else {
            // A report that is malformed.
            return Ok(1);
        };
        self.device = Some(device);
        let state = state.to_report();
        report[..state.len()].copy_from_slice(&state);
        Ok(state.len())
    }

    fn write(&mut self, report: &[u8]) -> Result<(), TransportError> {
        let report: &[u8; FORCE_BYTES] = report.try_into().map_err(|_| TransportError::Failed)?;
        let (words, _) = report.as_chunks::<4>();
        let force = [0, 1, 2].map(|axis: usize| f32::from_le_bytes(words[axis]));
        // The service answers every message; the first ones ask which devices there are.
        let message = match &self.device {
            Some(device) => force_message(device, force, self.dialect),
            None => "{}".into(),
        };
        self.socket.send(Message::text(message)).map_err(|_| TransportError::Disconnected)
    }
}
