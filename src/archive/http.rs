//! Files behind a web server: read by ranges ([`HttpRange`]), or whole ([`HttpFolder`]).
//!
//! Any server of static files will do, as long as it answers range requests, and object stores do
//! too. Connections are kept and shared: all that reads from one server goes through clones of one
//! [`HttpClient`]. Everything blocks until the answer is there, and may be called from many threads
//! at once; each of them has a connection of its own meanwhile.
//!
//! Servers are trusted as little as files are: an answer that isn't what was asked for is an error
//! that names the address, no answer is read further than was asked for, and none is waited for
//! longer than [`HttpSettings`] says. Bytes that changed on the way are found by whoever knows
//! their checksum.
//!
//! `https` trusts the certificate authorities that browsers trust, not the system's own list, and
//! a proxy is taken from the environment (`HTTPS_PROXY`, `HTTP_PROXY`, `ALL_PROXY`, `NO_PROXY`).

mod folder;
mod settings;

pub use folder::HttpFolder;
pub use settings::{HttpSettings, HttpSettingsError};

use super::{RangeError, RangeSource};
use std::io::{self, ErrorKind, Read};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;
use ureq::http::header::{
    ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_LENGTH, CONTENT_RANGE, ETAG, HeaderName,
    LAST_MODIFIED, RANGE,
};
use ureq::http::{Response, StatusCode};
use ureq::{Agent, Body};

/// The largest file that [`HttpFolder::read`] reads, 32 MiB.
pub const FOLDER_FILE_LIMIT: u64 = 32 << 20;
/// The largest file, 64 KiB, of which ranges are read although its server always sends all of it.
pub const WHOLE_ANSWER_LIMIT: u64 = 64 << 10;

/// No pause between two tries is longer than this.
const LONGEST_PAUSE_S: f32 = 30.0;
/// Memory that is taken before the first byte has come.
const FIRST_CAPACITY: u64 = 1 << 20;

const REPLACED: &str = "it was replaced on the server while it was being read; open it again";

/// Connections to web servers. Clones share them, and cost nothing.
///
/// A connection takes 256 KiB of memory. Those that are idle are closed after 15 seconds.
#[derive(Clone)]
pub struct HttpClient {
    agent: Agent,
    settings: Arc<HttpSettings>,
}

impl HttpClient {
    /// A client, as yet without a connection. Settings that can't be used are replaced by their
    /// defaults; [`HttpSettings::checked`] says which.
    #[must_use]
    pub fn new(settings: &HttpSettings) -> Self {
        let settings = settings.checked(|_| ());
        let idle = settings.idle_connections as usize;
        let agent = Agent::config_builder()
            .http_status_as_error(false)
            .timeout_connect(Some(Duration::from_secs_f32(settings.connect_timeout_s)))
            .timeout_global(Some(Duration::from_secs_f32(settings.timeout_s)))
            .max_idle_connections(idle)
            .max_idle_connections_per_host(idle)
            .user_agent(concat!(
                env!("CARGO_PKG_NAME"),
                "/",
                env!("CARGO_PKG_VERSION")
            ))
            .build()
            .new_agent();
        Self {
            agent,
            settings: Arc::new(settings),
        }
    }

    /// The settings that are used.
    #[must_use]
    pub fn settings(&self) -> &HttpSettings {
        &self.settings
    }

    /// What `attempt` makes, tried again as often as the settings say where that may help.
    fn retried<T>(&self, mut attempt: impl FnMut() -> Result<T, Failure>) -> Result<T, RangeError> {
        let mut pause_s = self.settings.retry_pause_s;
        let mut left = self.settings.retries;
        loop {
            match attempt() {
                Ok(made) => return Ok(made),
                Err(failure) if failure.may_pass && left > 0 => {
                    left -= 1;
                    thread::sleep(Duration::from_secs_f32(pause_s));
                    pause_s = (pause_s * 2.0).min(LONGEST_PAUSE_S);
                }
                Err(failure) => return Err(failure.error),
            }
        }
    }

    /// Asks for `address`, or for a range of it; the answer's status is 200, or for
    /// a range 206 or 416 too.
    fn ask(&self, address: &Address, range: Option<String>) -> Result<Response<Body>, Failure> {
        let other = |reason: &str| Failure::lasting(address.other(reason));
        if !address.is_http() {
            return Err(other(
                "it is no web address; one starts with http:// or https://",
            ));
        }
        let ranged = range.is_some();
        // Ranges of compressed bytes would be other ranges.
        let mut request = self
            .agent
            .get(&address.url)
            .header(ACCEPT_ENCODING, "identity");
        if let Some(range) = range {
            request = request.header(RANGE, range);
        }
        let answer = request
            .call()
            .map_err(|error| self.failed(address, error))?;
        let name = || address.name.clone();
        match answer.status() {
            StatusCode::OK => {}
            StatusCode::PARTIAL_CONTENT | StatusCode::RANGE_NOT_SATISFIABLE if ranged => {}
            StatusCode::NOT_FOUND | StatusCode::GONE => {
                return Err(Failure::lasting(RangeError::Missing { name: name() }));
            }
            status => {
                return Err(Failure {
                    may_pass: status.is_server_error(),
                    error: RangeError::Status {
                        name: name(),
                        status: status.as_u16(),
                    },
                });
            }
        }
        match header(&answer, CONTENT_ENCODING) {
            Some(encoding) if !encoding.eq_ignore_ascii_case("identity") => Err(other(
                "the server sends it compressed, although it was asked not to; switch that off \
                 for such files",
            )),
            _ => Ok(answer),
        }
    }

    /// The answer's body if it has at most `most` bytes, none if it has more. No more than one byte
    /// past `most` is read.
    fn body(
        &self,
        address: &Address,
        answer: Response<Body>,
        most: u64,
    ) -> Result<Option<Vec<u8>>, Failure> {
        let promised = promised_length(&answer);
        if promised.is_some_and(|promised| promised > most) {
            return Ok(None);
        }
        let capacity = promised.unwrap_or(0).min(FIRST_CAPACITY);
        let mut bytes = Vec::with_capacity(capacity as usize);
        // Reading to the end, and not just as many, gives the connection back.
        let mut reader = answer
            .into_body()
            .into_reader()
            .take(most.saturating_add(1));
        match reader.read_to_end(&mut bytes) {
            Ok(_) => Ok((bytes.len() as u64 <= most).then_some(bytes)),
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                Err(address.short(promised.unwrap_or(most)))
            }
            Err(error) => Err(self.failed(address, error.into())),
        }
    }

    fn failed(&self, address: &Address, error: ureq::Error) -> Failure {
        let timeout = |seconds| RangeError::Timeout {
            name: address.name.clone(),
            seconds,
        };
        let connection = |error: &io::Error| {
            address.other(&format!(
                "the connection failed ({error}); check the address and that the server runs"
            ))
        };
        let (may_pass, error) = match error {
            ureq::Error::Timeout(ureq::Timeout::Connect) => {
                (true, timeout(self.settings.connect_timeout_s))
            }
            ureq::Error::Timeout(_) => (true, timeout(self.settings.timeout_s)),
            ureq::Error::Io(error) => match error.kind() {
                ErrorKind::TimedOut | ErrorKind::WouldBlock => {
                    (true, timeout(self.settings.timeout_s))
                }
                // What isn't understood, a certificate for instance, isn't so the next time.
                ErrorKind::InvalidData | ErrorKind::InvalidInput => (false, connection(&error)),
                _ => (true, connection(&error)),
            },
            ureq::Error::ConnectionFailed => (
                true,
                address.other("the server can't be reached; check the address"),
            ),
            ureq::Error::HostNotFound => (
                false,
                address.other("there is no such server; check the address"),
            ),
            ureq::Error::TooManyRedirects => (
                false,
                address.other("the server sends on from address to address without end"),
            ),
            // Its own text holds the address, with the password if there is one.
            ureq::Error::BadUri(_) => (
                false,
                address.other("it is no web address; check how it is written"),
            ),
            error => (false, address.other(&error.to_string())),
        };
        Failure { error, may_pass }
    }
}

/// Why a try failed.
struct Failure {
    error: RangeError,
    /// Whether another try may succeed.
    may_pass: bool,
}

impl Failure {
    const fn lasting(error: RangeError) -> Self {
        Self {
            error,
            may_pass: false,
        }
    }
}

/// Where a file lies.
struct Address {
    url: String,
    /// The URL without user name, password and query, which may hold keys.
    name: String,
}

impl Address {
    fn new(url: String) -> Self {
        let authority = url.find("://").map_or(0, |at| at + 3);
        let end = url[authority..]
            .find(['/', '?', '#'])
            .map_or(url.len(), |at| authority + at);
        let path_end = url.find(['?', '#']).unwrap_or(url.len());
        let host = match url[authority..end].rfind('@') {
            Some(at) => authority + at + 1,
            None => authority,
        };
        let name = format!("{}{}", &url[..authority], &url[host..path_end.max(host)]);
        Self { url, name }
    }

    fn is_http(&self) -> bool {
        let starts_with = |scheme: &str| {
            let start = self.url.get(..scheme.len());
            start.is_some_and(|start| start.eq_ignore_ascii_case(scheme))
        };
        starts_with("http://") || starts_with("https://")
    }

    fn other(&self, reason: &str) -> RangeError {
        RangeError::Other {
            name: self.name.clone(),
            reason: reason.to_owned(),
        }
    }

    /// The answer ended before `wanted`. The connection may have, so another try may succeed.
    fn short(&self, wanted: u64) -> Failure {
        Failure {
            error: RangeError::Short {
                name: self.name.clone(),
                wanted,
            },
            may_pass: true,
        }
    }
}

fn header<T>(answer: &Response<T>, name: HeaderName) -> Option<&str> {
    answer.headers().get(name)?.to_str().ok()
}

fn promised_length<T>(answer: &Response<T>) -> Option<u64> {
    header(answer, CONTENT_LENGTH)?.trim().parse().ok()
}

/// What tells a file from the one that comes to stand at the same address later.
#[derive(Clone, PartialEq, Eq)]
struct Identity {
    etag: Option<String>,
    /// Left out where there is an ETag: the servers behind one address often disagree on it.
    last_modified: Option<String>,
    total: Option<u64>,
}

impl Identity {
    fn of<T>(answer: &Response<T>, total: Option<u64>) -> Self {
        let text = |name| header(answer, name).map(str::to_owned);
        let etag = text(ETAG);
        let last_modified = match etag {
            Some(_) => None,
            None => text(LAST_MODIFIED),
        };
        Self {
            etag,
            last_modified,
            total,
        }
    }
}

type FirstAndLast = (u64, u64);

/// The first byte and the last one of a `Content-Range` header, and the file's length.
fn content_range(text: &str) -> Option<(Option<FirstAndLast>, Option<u64>)> {
    let (range, total) = text.trim().strip_prefix("bytes ")?.split_once('/')?;
    let total = match total {
        "*" => None,
        total => Some(total.parse().ok()?),
    };
    if range == "*" {
        return Some((None, total));
    }
    let (first, last) = range.split_once('-')?;
    Some((Some((first.parse().ok()?, last.parse().ok()?)), total))
}

/// One file behind a web server, read by ranges.
///
/// The first answer says which file it is: its `ETag`, or else its `Last-Modified`, and its length.
/// Once another file stands at the address, every read is an error that says so, and what was read
/// before remains of one piece with what was read after; a new `HttpRange` reads the new file. A
/// server that sends neither header hides a file of the same length from this.
///
/// A read of `n` bytes is one request and takes `n` bytes of memory.
pub struct HttpRange {
    client: HttpClient,
    address: Address,
    identity: OnceLock<Identity>,
}

impl HttpRange {
    /// The file at `url`, which starts with `http://` or `https://` and is percent-encoded. Nothing
    /// is asked of the server yet.
    #[must_use]
    pub fn new(client: HttpClient, url: impl Into<String>) -> Self {
        Self {
            client,
            address: Address::new(url.into()),
            identity: OnceLock::new(),
        }
    }

    fn lasting<T>(&self, reason: &str) -> Result<T, Failure> {
        Err(Failure::lasting(self.address.other(reason)))
    }

    /// Remembers `identity` if it is the first, and else compares it with that.
    fn check_identity(&self, identity: Identity) -> Result<(), Failure> {
        let mut latest = Some(identity);
        let first = self
            .identity
            .get_or_init(|| latest.take().expect("it is made once"));
        match latest {
            Some(latest) if latest != *first => self.lasting(REPLACED),
            _ => Ok(()),
        }
    }

    fn attempt(&self, first: u64, length: u64, end: u64) -> Result<Vec<u8>, Failure> {
        let range = format!("bytes={first}-{}", end - 1);
        let answer = self.client.ask(&self.address, Some(range))?;
        let named = header(&answer, CONTENT_RANGE).map(content_range);
        let ends = || Failure {
            may_pass: false,
            ..self.address.short(end)
        };
        match (answer.status(), named) {
            (StatusCode::OK, _) => return self.cut(answer, first, end),
            (StatusCode::RANGE_NOT_SATISFIABLE, named) => {
                // Most servers leave the validators out here.
                let now = named.flatten().and_then(|(_, total)| total);
                let then = self.identity.get().and_then(|identity| identity.total);
                return match (then, now) {
                    (Some(then), Some(now)) if then != now => self.lasting(REPLACED),
                    _ => Err(ends()),
                };
            }
            (_, Some(Some((Some((from, to)), total)))) => {
                self.check_identity(Identity::of(&answer, total))?;
                if from == first && total.is_some_and(|total| total < end) {
                    return Err(ends());
                }
                if (from, to) != (first, end - 1) {
                    return self.lasting(&format!(
                        "the server sends bytes {from} to {to} where {first} to {} were asked \
                         for; it must support range requests",
                        end - 1
                    ));
                }
            }
            _ => {
                return self.lasting(
                    "the server doesn't say which bytes it sends; it must support range requests",
                );
            }
        }
        match self.client.body(&self.address, answer, length) {
            Ok(Some(bytes)) if bytes.len() as u64 == length => Ok(bytes),
            Ok(Some(_)) => Err(self.address.short(end)),
            Ok(None) => self.lasting(&format!(
                "the server sends more than the {length} bytes that were asked for"
            )),
            Err(failure) => Err(match failure.error {
                RangeError::Short { .. } => self.address.short(end),
                _ => failure,
            }),
        }
    }

    /// The range out of an answer that holds the whole file.
    fn cut(&self, answer: Response<Body>, first: u64, end: u64) -> Result<Vec<u8>, Failure> {
        let promised = promised_length(&answer);
        let mut identity = Identity::of(&answer, promised);
        // Before the size is looked at: a file that was replaced is called that, however large.
        if promised.is_some() {
            self.check_identity(identity.clone())?;
        }
        let Some(mut bytes) = self
            .client
            .body(&self.address, answer, WHOLE_ANSWER_LIMIT)?
        else {
            return self.lasting(
                "the server sends the whole file where a part was asked for; it must support range \
                 requests",
            );
        };
        if promised.is_none() {
            identity.total = Some(bytes.len() as u64);
            self.check_identity(identity)?;
        }
        if (bytes.len() as u64) < end {
            return Err(Failure {
                may_pass: false,
                ..self.address.short(end)
            });
        }
        bytes.truncate(end as usize);
        bytes.drain(..first as usize);
        Ok(bytes)
    }
}

impl RangeSource for HttpRange {
    /// The URL, without user name, password and query.
    fn name(&self) -> String {
        self.address.name.clone()
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, RangeError> {
        if length == 0 {
            return Ok(Vec::new());
        }
        let length = length as u64;
        let Some(end) = offset.checked_add(length) else {
            return Err(self.address.short(u64::MAX).error);
        };
        self.client.retried(|| self.attempt(offset, length, end))
    }
}
