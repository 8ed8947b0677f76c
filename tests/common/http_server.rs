//! A web server for tests: files from memory or from a folder, on the loopback interface, with
//! ranges, connections that are kept, and faults on demand. Include it with
//! `#[path = "common/http_server.rs"] mod http_server;`.
#![allow(dead_code, reason = "each test file uses a part of it")]

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Request {
    /// Counts from 0, over all connections.
    pub number: usize,
    pub method: String,
    /// As it was sent: percent-encoded, with the query.
    pub target: String,
    /// Decoded, without the slash at its start and without the query.
    pub path: String,
    /// First byte and last one, if it is a request for a range.
    pub range: Option<(u64, Option<u64>)>,
    /// Names in lower case.
    pub headers: HashMap<String, String>,
}

/// What goes wrong with the answer.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Fault {
    #[default]
    None,
    /// This status and no file.
    Status(u16),
    /// The answer comes late.
    Delay(Duration),
    /// It never comes, and the connection stays.
    Never,
    Trickle {
        bytes_per_s: u32,
    },
    /// The connection ends after so many bytes of the body, all of which were promised.
    Truncate(usize),
    /// This byte of the body is another one.
    Corrupt(usize),
    /// Ranges are ignored.
    WholeInsteadOfRange,
    /// The connection ends without an answer.
    CloseEarly,
    /// The body has so many bytes more, and says so.
    Longer(usize),
    /// The body comes in chunks, so that its length isn't known, and has so many bytes more.
    Chunked(usize),
    /// A range that starts so many bytes later.
    Shifted(u64),
    /// This header is sent instead, or left out where it is empty.
    Header(&'static str, String),
    /// A body and, for a range, a file of so many bytes are promised; what is there is sent.
    Promise(u64),
    /// To another address.
    Redirect(String),
}

/// Which headers say which file it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validators {
    #[default]
    Both,
    LastModified,
    None,
}

type FaultOf = Box<dyn Fn(&Request) -> Fault + Send + Sync>;

/// Versions count up.
type Versioned = (usize, Arc<Vec<u8>>);

enum Files {
    Memory(Mutex<HashMap<String, Versioned>>),
    Folder(PathBuf),
}

struct Shared {
    files: Files,
    fault: FaultOf,
    validators: Mutex<Validators>,
    requests: AtomicUsize,
    connections: AtomicUsize,
    versions: AtomicUsize,
    stopped: Mutex<bool>,
    stop: Condvar,
}

impl Shared {
    /// Whether the server goes on after `time`.
    fn wait(&self, time: Duration) -> bool {
        let stopped = self.stopped.lock().unwrap();
        let (stopped, _) = self
            .stop
            .wait_timeout_while(stopped, time, |stopped| !*stopped)
            .unwrap();
        !*stopped
    }

    fn is_stopped(&self) -> bool {
        *self.stopped.lock().unwrap()
    }
}

/// Serves until it is dropped.
pub struct HttpServer {
    address: SocketAddr,
    shared: Arc<Shared>,
    listening: Option<JoinHandle<()>>,
}

impl HttpServer {
    /// Serves what [`put`](Self::put) puts there.
    pub fn new() -> Self {
        Self::with_faults(|_| Fault::None)
    }

    pub fn with_faults(fault: impl Fn(&Request) -> Fault + Send + Sync + 'static) -> Self {
        Self::start(Files::Memory(Mutex::default()), Box::new(fault))
    }

    /// Serves the files of `folder`.
    pub fn of_folder(
        folder: &Path,
        fault: impl Fn(&Request) -> Fault + Send + Sync + 'static,
    ) -> Self {
        Self::start(Files::Folder(folder.to_owned()), Box::new(fault))
    }

    fn start(files: Files, fault: FaultOf) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("the loopback interface has a port");
        let address = listener.local_addr().unwrap();
        let shared = Arc::new(Shared {
            files,
            fault,
            validators: Mutex::default(),
            requests: AtomicUsize::new(0),
            connections: AtomicUsize::new(0),
            versions: AtomicUsize::new(0),
            stopped: Mutex::new(false),
            stop: Condvar::new(),
        });
        let listening = Some(thread::spawn({
            let shared = shared.clone();
            move || listen(&listener, &shared)
        }));
        Self {
            address,
            shared,
            listening,
        }
    }

    /// Puts a file there, or another one in its place. Only without a folder.
    pub fn put(&self, path: &str, bytes: impl Into<Vec<u8>>) {
        let Files::Memory(files) = &self.shared.files else {
            panic!("a folder's files are on the disk");
        };
        let version = self.shared.versions.fetch_add(1, Ordering::Relaxed);
        let file = (version, Arc::new(bytes.into()));
        files.lock().unwrap().insert(path.to_owned(), file);
    }

    pub fn set_validators(&self, validators: Validators) {
        *self.shared.validators.lock().unwrap() = validators;
    }

    /// The URL of a path that needs no encoding.
    pub fn url(&self, path: &str) -> String {
        format!("http://{}/{path}", self.address)
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    pub fn requests(&self) -> usize {
        self.shared.requests.load(Ordering::Relaxed)
    }

    pub fn connections(&self) -> usize {
        self.shared.connections.load(Ordering::Relaxed)
    }
}

impl Drop for HttpServer {
    fn drop(&mut self) {
        *self.shared.stopped.lock().unwrap() = true;
        self.shared.stop.notify_all();
        // Wakes the thread that listens.
        drop(TcpStream::connect(self.address));
        if let Some(listening) = self.listening.take() {
            let ended = listening.join();
            assert!(thread::panicking() || ended.is_ok(), "the server panicked");
        }
    }
}

/// Ends its connection although the stream has clones, and although a fault's closure panics.
struct Closing(TcpStream);

impl Drop for Closing {
    fn drop(&mut self) {
        let _ = self.0.shutdown(Shutdown::Both);
    }
}

fn listen(listener: &TcpListener, shared: &Arc<Shared>) {
    let mut connections: Vec<(TcpStream, JoinHandle<()>)> = Vec::new();
    for stream in listener.incoming() {
        if shared.is_stopped() {
            break;
        }
        let Ok(stream) = stream else { continue };
        shared.connections.fetch_add(1, Ordering::Relaxed);
        stream.set_nodelay(true).unwrap();
        let mine = stream.try_clone().unwrap();
        let serving = thread::spawn({
            let shared = shared.clone();
            move || {
                let stream = Closing(stream);
                // What a client does to its connection is its own affair.
                let _ = serve(&stream.0, &shared);
            }
        });
        connections.retain(|(_, serving)| !serving.is_finished());
        connections.push((mine, serving));
    }
    for (stream, _) in &connections {
        let _ = stream.shutdown(Shutdown::Both);
    }
    for (_, serving) in connections {
        serving.join().expect("serving doesn't panic");
    }
}

/// Answers until the client or a fault ends the connection.
fn serve(stream: &TcpStream, shared: &Shared) -> io::Result<()> {
    let mut reader = BufReader::new(stream);
    while let Some(request) = read_request(&mut reader, shared)? {
        if !answer(stream, shared, &request)? {
            break;
        }
    }
    Ok(())
}

fn read_request(
    reader: &mut BufReader<&TcpStream>,
    shared: &Shared,
) -> io::Result<Option<Request>> {
    let mut line = String::new();
    if reader.read_line(&mut line)? == 0 {
        return Ok(None);
    }
    let mut words = line.split_whitespace().map(str::to_owned);
    let (Some(method), Some(target)) = (words.next(), words.next()) else {
        return Ok(None);
    };
    let mut headers = HashMap::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        let Some((name, value)) = line.trim_end().split_once(':') else {
            break;
        };
        headers.insert(name.to_lowercase(), value.trim().to_owned());
    }
    let range = headers.get("range").and_then(|range| {
        let (first, last) = range.strip_prefix("bytes=")?.split_once('-')?;
        Some((first.parse().ok()?, last.parse().ok()))
    });
    let path = target.split(['?', '#']).next().unwrap_or_default();
    Ok(Some(Request {
        number: shared.requests.fetch_add(1, Ordering::Relaxed),
        method,
        path: decoded(path.trim_start_matches('/')),
        target,
        range,
        headers,
    }))
}

fn decoded(path: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = path.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        let code = after.get(..2).and_then(|code| str::from_utf8(code).ok());
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()) {
            Some(code) if byte == b'%' => {
                bytes.push(code);
                rest = &after[2..];
            }
            _ => {
                bytes.push(byte);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// A file's length, what its version is called, and its bytes.
struct Found {
    length: u64,
    version: u64,
    bytes: Bytes,
}

enum Bytes {
    Memory(Arc<Vec<u8>>),
    Disk(File),
}

impl Found {
    fn at(path: &str, files: &Files) -> Option<Self> {
        match files {
            Files::Memory(files) => {
                let (version, bytes) = files.lock().unwrap().get(path)?.clone();
                Some(Self {
                    length: bytes.len() as u64,
                    version: version as u64,
                    bytes: Bytes::Memory(bytes),
                })
            }
            Files::Folder(folder) => {
                if path.split('/').any(|part| part == "..") {
                    return None;
                }
                let file = File::open(folder.join(path)).ok()?;
                let metadata = file.metadata().ok().filter(|found| found.is_file())?;
                let modified = metadata.modified().ok()?;
                let since = modified.duration_since(std::time::UNIX_EPOCH).ok()?;
                Some(Self {
                    length: metadata.len(),
                    version: since.as_nanos() as u64,
                    bytes: Bytes::Disk(file),
                })
            }
        }
    }

    fn read(self, first: u64, end: u64) -> io::Result<Vec<u8>> {
        match self.bytes {
            Bytes::Memory(bytes) => Ok(bytes[first as usize..end as usize].to_vec()),
            Bytes::Disk(mut file) => {
                let mut bytes = vec![0; (end - first) as usize];
                file.seek(SeekFrom::Start(first))?;
                file.read_exact(&mut bytes)?;
                Ok(bytes)
            }
        }
    }
}

fn status_only(mut stream: &TcpStream, status: u16, more: &str) -> io::Result<bool> {
    let head = format!("HTTP/1.1 {status} Status\r\nContent-Length: 0\r\n{more}\r\n");
    stream.write_all(head.as_bytes())?;
    Ok(true)
}

/// Whether the connection goes on.
fn answer(mut stream: &TcpStream, shared: &Shared, request: &Request) -> io::Result<bool> {
    let fault = (shared.fault)(request);
    match &fault {
        Fault::Status(status) => return status_only(stream, *status, ""),
        Fault::Redirect(to) => return status_only(stream, 302, &format!("Location: {to}\r\n")),
        Fault::Delay(time) if !shared.wait(*time) => return Ok(false),
        Fault::Never => {
            while shared.wait(Duration::from_secs(3600)) {}
            return Ok(false);
        }
        Fault::CloseEarly => return Ok(false),
        _ => {}
    }
    let Some(found) = Found::at(&request.path, &shared.files) else {
        return status_only(stream, 404, "");
    };
    let total = found.length;
    let range = request
        .range
        .filter(|_| fault != Fault::WholeInsteadOfRange);
    let (mut first, end) = match range {
        Some((first, _)) if first >= total => {
            return status_only(stream, 416, &format!("Content-Range: bytes */{total}\r\n"));
        }
        Some((first, last)) => (first, last.map_or(total, |last| (last + 1).min(total))),
        None => (0, total),
    };
    if let Fault::Shifted(by) = fault {
        first = (first + by).min(end - 1);
    }
    let mut headers = HashMap::from([("Accept-Ranges", "bytes".to_owned())]);
    let validators = *shared.validators.lock().unwrap();
    if validators == Validators::Both {
        headers.insert("ETag", format!("\"{:x}\"", found.version));
    }
    if validators != Validators::None {
        // Not a date, but nobody reads it as one.
        let date = format!("version {:x}", found.version);
        headers.insert("Last-Modified", date);
    }
    if range.is_some() {
        let range = format!("bytes {first}-{}/{total}", end - 1);
        headers.insert("Content-Range", range);
    }
    let mut body = found.read(first, end)?;
    match fault {
        Fault::Corrupt(at) if at < body.len() => body[at] ^= 1,
        Fault::Longer(by) | Fault::Chunked(by) => body.resize(body.len() + by, 0xaa),
        _ => {}
    }
    headers.insert("Content-Length", body.len().to_string());
    match &fault {
        Fault::Chunked(_) => {
            headers.remove("Content-Length");
            headers.insert("Transfer-Encoding", "chunked".to_owned());
            body = chunked(&body);
        }
        Fault::Truncate(at) => body.truncate(*at),
        Fault::Promise(length) => {
            headers.insert("Content-Length", length.to_string());
            let range = format!("bytes {first}-{}/{length}", first + length - 1);
            headers.insert("Content-Range", range);
        }
        Fault::Header(name, value) if value.is_empty() => {
            headers.remove(name);
        }
        Fault::Header(name, value) => {
            headers.insert(name, value.clone());
        }
        _ => {}
    }
    let status = if range.is_some() { 206 } else { 200 };
    let mut message = format!("HTTP/1.1 {status} Status\r\n").into_bytes();
    for (name, value) in headers {
        write!(message, "{name}: {value}\r\n")?;
    }
    message.extend_from_slice(b"\r\n");
    match fault {
        Fault::Trickle { bytes_per_s } => {
            stream.write_all(&message)?;
            let pause = Duration::from_secs(1) / bytes_per_s.max(1);
            for byte in body {
                stream.write_all(&[byte])?;
                if !shared.wait(pause) {
                    return Ok(false);
                }
            }
            Ok(true)
        }
        _ => {
            if request.method != "HEAD" {
                message.append(&mut body);
            }
            stream.write_all(&message)?;
            Ok(!matches!(fault, Fault::Truncate(_) | Fault::Promise(_)))
        }
    }
}

fn chunked(body: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for chunk in body.chunks(1000) {
        out.extend_from_slice(format!("{:x}\r\n", chunk.len()).as_bytes());
        out.extend_from_slice(chunk);
        out.extend_from_slice(b"\r\n");
    }
    out.extend_from_slice(b"0\r\n\r\n");
    out
}
