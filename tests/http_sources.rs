//! What lies behind a web server is read as it is, or refused in a sentence that names the address;
//! and nobody waits for a server for ever.

#[path = "common/http_server.rs"]
mod http_server;
#[path = "common/random.rs"]
#[expect(dead_code, reason = "each test file uses a part of it")]
mod random;

use bevy_tessera::archive::{
    FOLDER_FILE_LIMIT, HttpClient, HttpFolder, HttpRange, HttpSettings, RangeError, RangeSource,
    WHOLE_ANSWER_LIMIT,
};
use http_server::{Fault, HttpServer, Request, Validators};
use proptest::prelude::*;
use random::Random;
use std::sync::LazyLock;
use std::thread;
use std::time::{Duration, Instant};

/// Waits long, so that a busy machine fails no test, but hardly between two tries.
fn patient(retries: u32) -> HttpClient {
    HttpClient::new(&HttpSettings {
        retries,
        retry_pause_s: 0.001,
        ..HttpSettings::default()
    })
}

fn impatient(retries: u32) -> HttpClient {
    HttpClient::new(&HttpSettings {
        timeout_s: 0.2,
        retries,
        retry_pause_s: 0.001,
        ..HttpSettings::default()
    })
}

fn bytes(length: usize, seed: u64) -> Vec<u8> {
    let mut random = Random(seed + 1);
    (0..length).map(|_| (random.next() >> 32) as u8).collect()
}

/// A server of one file, `file`, of 5000 bytes.
fn server(fault: impl Fn(&Request) -> Fault + Send + Sync + 'static) -> HttpServer {
    let server = HttpServer::with_faults(fault);
    server.put("file", bytes(5000, 0));
    server
}

fn first_only(fault: Fault) -> impl Fn(&Request) -> Fault {
    move |request| match request.number {
        0 => fault.clone(),
        _ => Fault::None,
    }
}

fn always(fault: Fault) -> impl Fn(&Request) -> Fault {
    move |_| fault.clone()
}

fn reason(error: &RangeError) -> String {
    match error {
        RangeError::Other { reason, .. } => reason.clone(),
        error => panic!("{error:?}"),
    }
}

/// Why a range of the file can't be read, in one request.
#[track_caller]
fn refused(fault: Fault) -> String {
    let server = server(always(fault));
    let file = HttpRange::new(patient(2), server.url("file"));
    let error = file.read_at(100, 50).expect_err("it is refused");
    assert!(error.to_string().contains(&server.url("file")), "{error}");
    assert_eq!(server.requests(), 1, "{error}");
    reason(&error)
}

proptest! {
    #[test]
    fn every_range_holds_the_files_bytes(first in 0_usize..5000, length in 0_usize..5000) {
        static SERVER: LazyLock<HttpServer> = LazyLock::new(|| server(|_| Fault::None));
        static FILE: LazyLock<HttpRange> =
            LazyLock::new(|| HttpRange::new(patient(0), SERVER.url("file")));
        let length = length.min(5000 - first);
        let read = FILE.read_at(first as u64, length);
        prop_assert_eq!(read.unwrap(), &bytes(5000, 0)[first..first + length]);
    }
}

#[test]
fn many_threads_read_at_once_over_a_connection_each() {
    let server = HttpServer::new();
    let whole = bytes(1 << 20, 3);
    server.put("large", whole.clone());
    let file = HttpRange::new(patient(0), server.url("large"));
    thread::scope(|scope| {
        for thread in 0..8 {
            let (file, whole) = (&file, &whole);
            scope.spawn(move || {
                let mut random = Random(thread + 77);
                for _ in 0..200 {
                    let length = random.below(50_000) as usize + 1;
                    let first = random.below((whole.len() - length) as i32 + 1) as usize;
                    let read = file.read_at(first as u64, length).unwrap();
                    assert!(read == whole[first..first + length], "{first} +{length}");
                }
            });
        }
    });
    assert_eq!(server.requests(), 1600);
    assert!(server.connections() <= 16, "{}", server.connections());
}

#[test]
fn clones_of_a_client_share_its_connections() {
    let server = server(|_| Fault::None);
    let client = patient(0);
    for _ in 0..20 {
        let file = HttpRange::new(client.clone(), server.url("file"));
        assert_eq!(file.read_at(0, 10).unwrap(), bytes(5000, 0)[..10]);
        let folder = HttpFolder::new(client.clone(), &server.url(""));
        assert_eq!(folder.read("file").unwrap(), bytes(5000, 0));
    }
    assert_eq!((server.requests(), server.connections()), (40, 1));
}

#[test]
fn reading_nothing_asks_for_nothing() {
    let server = server(|_| Fault::None);
    let file = HttpRange::new(patient(0), server.url("file"));
    assert!(file.read_at(u64::MAX, 0).unwrap().is_empty());
    let error = file.read_at(u64::MAX, 2).unwrap_err();
    assert!(matches!(error, RangeError::Short { .. }), "{error}");
    assert_eq!(server.requests(), 0);
}

#[test]
fn a_file_that_is_not_there_is_missing() {
    let server = server(|request| match request.path.as_str() {
        "gone" => Fault::Status(410),
        _ => Fault::None,
    });
    for path in ["nothing", "gone"] {
        let asked = server.requests();
        let file = HttpRange::new(patient(2), server.url(path));
        let error = file.read_at(0, 10).unwrap_err();
        assert!(matches!(error, RangeError::Missing { .. }), "{error:?}");
        assert_eq!(
            error.to_string(),
            format!("{} is missing", server.url(path))
        );
        let error = HttpFolder::new(patient(2), &server.url("")).read(path);
        assert!(
            matches!(error, Err(RangeError::Missing { .. })),
            "{error:?}"
        );
        assert_eq!(server.requests(), asked + 2, "it is asked for once");
    }
}

#[test]
fn what_a_server_refuses_is_not_asked_for_again() {
    for status in [400, 401, 403, 418, 429] {
        let server = server(always(Fault::Status(status)));
        let file = HttpRange::new(patient(3), server.url("file"));
        match file.read_at(0, 10).unwrap_err() {
            RangeError::Status { status: said, .. } => assert_eq!(said, status),
            error => panic!("{error:?}"),
        }
        assert_eq!(server.requests(), 1);
    }
}

#[test]
fn a_failing_server_is_asked_again_as_often_as_settings_say() {
    for status in [500, 502, 503, 504] {
        let server = server(move |request| match request.number {
            0 | 1 => Fault::Status(status),
            _ => Fault::None,
        });
        let file = HttpRange::new(patient(2), server.url("file"));
        assert_eq!(file.read_at(5, 10).unwrap(), bytes(5000, 0)[5..15]);
        assert_eq!(server.requests(), 3);
    }
    for retries in 0..4 {
        let server = server(always(Fault::Status(503)));
        let error = HttpFolder::new(patient(retries), &server.url("")).read("file");
        assert!(matches!(error, Err(RangeError::Status { status: 503, .. })));
        assert_eq!(server.requests(), 1 + retries as usize);
    }
}

#[test]
fn a_connection_that_ends_is_made_again() {
    for fault in [Fault::CloseEarly, Fault::Truncate(20), Fault::Truncate(0)] {
        let server = server(first_only(fault));
        let file = HttpRange::new(patient(1), server.url("file"));
        assert_eq!(file.read_at(5, 40).unwrap(), bytes(5000, 0)[5..45]);
        assert_eq!(server.requests(), 2);
    }
    let server = server(always(Fault::CloseEarly));
    let error = HttpRange::new(patient(1), server.url("file")).read_at(5, 40);
    let reason = reason(&error.unwrap_err());
    assert!(reason.contains("the connection failed"), "{reason}");
    assert_eq!(server.requests(), 2);
}

#[test]
fn a_server_that_is_not_there_is_an_error() {
    let url = HttpServer::new().url("file");
    let error = HttpRange::new(patient(1), url.clone()).read_at(0, 1);
    let error = error.unwrap_err();
    assert!(error.to_string().starts_with(&url), "{error}");
    assert!(reason(&error).contains("check the address"), "{error}");
}

#[test]
fn silence_is_a_timeout() {
    let server = server(always(Fault::Never));
    let file = HttpRange::new(impatient(1), server.url("file"));
    match file.read_at(0, 10).unwrap_err() {
        RangeError::Timeout { seconds, name } => {
            assert_eq!(seconds, 0.2);
            assert_eq!(name, server.url("file"));
        }
        error => panic!("{error:?}"),
    }
    assert_eq!(server.requests(), 2, "one more try");
}

#[test]
fn a_trickle_is_a_timeout() {
    // Bytes keep coming: it would take ten minutes, and no single wait is long.
    let server = server(always(Fault::Trickle { bytes_per_s: 50 }));
    let file = HttpRange::new(impatient(0), server.url("file"));
    let error = file.read_at(0, 5000).unwrap_err();
    assert!(matches!(error, RangeError::Timeout { .. }), "{error:?}");
    let error = HttpFolder::new(impatient(0), &server.url("")).read("file");
    assert!(
        matches!(error, Err(RangeError::Timeout { .. })),
        "{error:?}"
    );
}

#[test]
fn what_comes_late_but_in_time_is_read() {
    let server = server(always(Fault::Delay(Duration::from_millis(50))));
    let file = HttpRange::new(patient(0), server.url("file"));
    assert_eq!(file.read_at(0, 10).unwrap(), bytes(5000, 0)[..10]);
}

#[test]
fn an_answer_that_ends_early_is_short() {
    for cut in [0, 1, 49] {
        let server = server(always(Fault::Truncate(cut)));
        let file = HttpRange::new(patient(1), server.url("file"));
        match file.read_at(100, 50).unwrap_err() {
            RangeError::Short { wanted, .. } => assert_eq!(wanted, 150),
            error => panic!("{error:?}"),
        }
        match HttpFolder::new(patient(0), &server.url("")).read("file") {
            Err(RangeError::Short { wanted, .. }) => assert_eq!(wanted, 5000),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_range_past_the_files_end_is_short() {
    let server = server(|_| Fault::None);
    let file = HttpRange::new(patient(2), server.url("file"));
    for (first, length) in [(4999, 2), (0, 5001), (5000, 1), (1 << 40, 7)] {
        let asked = server.requests();
        match file.read_at(first, length).unwrap_err() {
            RangeError::Short { wanted, .. } => assert_eq!(wanted, first + length as u64),
            error => panic!("{error:?}"),
        }
        assert_eq!(server.requests(), asked + 1);
    }
    assert_eq!(file.read_at(4999, 1).unwrap(), bytes(5000, 0)[4999..]);
}

#[test]
fn more_bytes_than_asked_for_are_refused() {
    for fault in [Fault::Longer(1), Fault::Longer(1 << 26), Fault::Chunked(1)] {
        let reason = refused(fault);
        assert!(reason.contains("more than the 50 bytes"), "{reason}");
    }
    let server = server(always(Fault::Chunked(0)));
    let file = HttpRange::new(patient(0), server.url("file"));
    assert_eq!(file.read_at(100, 50).unwrap(), bytes(5000, 0)[100..150]);
}

#[test]
fn other_bytes_than_asked_for_are_refused() {
    let header = |value: &str| Fault::Header("Content-Range", value.to_owned());
    for fault in [
        Fault::Shifted(1),
        header("bytes 100-148/5000"),
        header("bytes 0-149/5000"),
        header("bytes 99-149/*"),
        header(""),
        header("bytes */5000"),
        header("bytes 100-149"),
        header("pages 100-149/5000"),
        header("bytes -100-149/5000"),
        header("bytes 100-99999999999999999999/5000"),
    ] {
        let reason = refused(fault.clone());
        assert!(
            reason.contains("must support range requests"),
            "{fault:?}: {reason}"
        );
    }
}

#[test]
fn a_server_that_cannot_do_ranges_is_refused_beyond_a_small_file() {
    let server = HttpServer::with_faults(always(Fault::WholeInsteadOfRange));
    let limit = WHOLE_ANSWER_LIMIT as usize;
    let whole = bytes(limit + 1, 9);
    server.put("small", &whole[..limit]);
    server.put("large", whole.clone());
    let small = HttpRange::new(patient(0), server.url("small"));
    assert_eq!(small.read_at(100, 50).unwrap(), whole[100..150]);
    assert_eq!(small.read_at(0, limit).unwrap(), whole[..limit]);
    let error = small.read_at(limit as u64 - 1, 2).unwrap_err();
    assert!(matches!(error, RangeError::Short { .. }), "{error:?}");
    let error = small.read_at(limit as u64 + 10, 2).unwrap_err();
    assert!(matches!(error, RangeError::Short { .. }), "{error:?}");
    let large = HttpRange::new(patient(2), server.url("large"));
    let asked = server.requests();
    let reason = reason(&large.read_at(100, 50).unwrap_err());
    assert!(reason.contains("the whole file"), "{reason}");
    assert!(reason.contains("must support range requests"), "{reason}");
    assert_eq!(server.requests(), asked + 1);
}

#[test]
fn a_file_that_is_replaced_is_never_mixed_with_the_one_before() {
    let same = |validators| (validators, 5000);
    for (validators, length) in [
        same(Validators::Both),
        same(Validators::LastModified),
        (Validators::Both, 6000),
        (Validators::None, 6000),
        (Validators::None, 60),
    ] {
        for ranges in [true, false] {
            let server = server(move |_| match ranges {
                true => Fault::None,
                false => Fault::WholeInsteadOfRange,
            });
            server.set_validators(validators);
            let client = patient(2);
            let file = HttpRange::new(client.clone(), server.url("file"));
            assert_eq!(file.read_at(40, 10).unwrap(), bytes(5000, 0)[40..50]);
            server.put("file", bytes(length, 1));
            // One range that the new file has, and one that it may not have.
            for first in [40, 4000] {
                let asked = server.requests();
                let reason = reason(&file.read_at(first, 10).unwrap_err());
                assert!(reason.contains("was replaced on the server"), "{reason}");
                assert!(reason.contains("open it again"), "{reason}");
                assert_eq!(server.requests(), asked + 1);
            }
            let again = HttpRange::new(client, server.url("file"));
            assert_eq!(again.read_at(40, 10).unwrap(), bytes(length, 1)[40..50]);
        }
    }
}

#[test]
fn a_large_file_that_is_replaced_behind_a_server_without_ranges_is_called_that() {
    let server = server(always(Fault::WholeInsteadOfRange));
    let file = HttpRange::new(patient(0), server.url("file"));
    file.read_at(0, 1).unwrap();
    server.put("file", bytes(1 << 20, 1));
    let reason = reason(&file.read_at(0, 1).unwrap_err());
    assert!(reason.contains("was replaced"), "{reason}");
}

#[test]
fn threads_never_read_two_files_as_one() {
    let server = HttpServer::new();
    server.put("file", vec![0; 1000]);
    let file = HttpRange::new(patient(0), server.url("file"));
    thread::scope(|scope| {
        let readers: Vec<_> = (0..4)
            .map(|_| {
                let file = &file;
                scope.spawn(move || {
                    let read = (0..300).filter_map(|_| file.read_at(10, 100).ok());
                    read.flatten().collect::<Vec<_>>()
                })
            })
            .collect();
        for version in 1..=100 {
            server.put("file", vec![version; 1000]);
        }
        let mut read = readers
            .into_iter()
            .flat_map(|reader| reader.join().unwrap());
        if let Some(first) = read.next() {
            assert!(read.all(|byte| byte == first));
        }
    });
}

#[test]
fn compressed_answers_are_refused() {
    let reason = refused(Fault::Header("Content-Encoding", "gzip".to_owned()));
    assert!(reason.contains("compressed"), "{reason}");
    let server = server(|request| {
        assert_eq!(request.headers["accept-encoding"], "identity");
        Fault::Header("Content-Encoding", "identity".to_owned())
    });
    let file = HttpRange::new(patient(0), server.url("file"));
    assert_eq!(file.read_at(0, 10).unwrap(), bytes(5000, 0)[..10]);
}

#[test]
fn redirects_are_followed_and_an_endless_one_is_an_error() {
    let server = server(|request| match request.path.as_str() {
        "old" => Fault::Redirect("/older".to_owned()),
        "older" => Fault::Redirect("/file".to_owned()),
        "round" => Fault::Redirect("/round".to_owned()),
        _ => Fault::None,
    });
    let file = HttpRange::new(patient(0), server.url("old"));
    assert_eq!(file.read_at(7, 10).unwrap(), bytes(5000, 0)[7..17]);
    let round = HttpRange::new(patient(0), server.url("round"));
    let reason = reason(&round.read_at(7, 10).unwrap_err());
    assert!(reason.contains("without end"), "{reason}");
}

#[test]
fn a_server_that_does_not_speak_tls_is_an_error() {
    let server = server(|_| Fault::None);
    let url = server.url("file").replace("http:", "https:");
    let error = HttpRange::new(patient(0), url.clone()).read_at(0, 10);
    let error = error.unwrap_err();
    assert!(error.to_string().starts_with(&url), "{error}");
}

#[test]
fn what_is_no_web_address_is_refused() {
    for url in [
        "",
        "terrain",
        "ftp://host/file",
        "http://",
        "http:// /",
        "http://a:b:c/",
        "http:/ä",
    ] {
        let error = HttpRange::new(patient(0), url).read_at(0, 10).unwrap_err();
        assert!(error.to_string().starts_with(url), "{error}");
        let scheme = url.starts_with("http:");
        assert!(scheme || reason(&error).contains("http://"), "{error}");
    }
}

#[test]
fn messages_hold_no_passwords_and_no_keys() {
    let host = "127.0.0.1:1";
    for url in [
        format!("http://user:secret@{host}/file?key=secret#secret"),
        format!("http://user:secret@{host}?key=secret"),
        format!("ftp://user:secret@{host}"),
        format!("http://user:secret@{host}:x/"),
        "http://user:secret@".to_owned(),
    ] {
        let file = HttpRange::new(patient(0), url);
        let error = file.read_at(0, 10).unwrap_err();
        assert!(!format!("{error} {error:?}").contains("secret"), "{error}");
        assert!(!file.name().contains("secret"));
    }
    let folder = HttpFolder::new(patient(0), &format!("http://u:secret@{host}/a?key=secret"));
    for path in ["file", "../file"] {
        let error = folder.read(path).unwrap_err();
        assert!(!format!("{error} {error:?}").contains("secret"), "{error}");
        assert!(error.to_string().contains("/a/"), "{error}");
    }
}

#[test]
fn a_folders_files_are_read_whole_whatever_their_names() {
    let server = HttpServer::new();
    for path in [
        "terrain.ron",
        "tile/0/1_2.tile",
        "a b/Ä+?#%25&/~.x",
        "empty",
    ] {
        let length = if path == "empty" { 0 } else { 3000 };
        server.put(&format!("base/{path}"), bytes(length, path.len() as u64));
        for base in ["base", "base/", "base?key=1", "base/?key=1#part"] {
            let folder = HttpFolder::new(patient(0), &server.url(base));
            assert_eq!(folder.read(path).unwrap(), bytes(length, path.len() as u64));
            if length > 0 {
                let range = folder.range(path).unwrap().read_at(10, 20).unwrap();
                assert_eq!(range, bytes(length, path.len() as u64)[10..30]);
            }
        }
    }
}

#[test]
fn a_folders_query_goes_with_each_file() {
    let server = HttpServer::with_faults(|request| {
        assert!(request.target.ends_with("?key=a%20b"), "{}", request.target);
        Fault::None
    });
    server.put("base/file", "all of it");
    let folder = HttpFolder::new(patient(0), &server.url("base/?key=a%20b"));
    assert_eq!(folder.read("file").unwrap(), b"all of it");
}

#[test]
fn paths_do_not_lead_out_of_a_folder() {
    let server = server(|_| Fault::None);
    let folder = HttpFolder::new(patient(0), &server.url("base"));
    for path in [
        "",
        "..",
        "../file",
        "a/../../file",
        "./file",
        "/file",
        "a//b",
        "a/",
        "..\\file",
    ] {
        let error = folder.read(path).unwrap_err();
        assert!(
            reason(&error).contains("inside a folder"),
            "{path}: {error}"
        );
        assert!(folder.range(path).is_err(), "{path}");
    }
    let hidden = folder.read("%2e%2e/file").unwrap_err();
    assert!(matches!(hidden, RangeError::Missing { .. }), "{hidden:?}");
    assert_eq!(server.requests(), 1);
}

#[test]
fn a_folders_files_have_a_largest_size() {
    let server = HttpServer::with_faults(|request| match request.path.as_str() {
        "chunks" => Fault::Chunked(1),
        _ => Fault::None,
    });
    let limit = FOLDER_FILE_LIMIT as usize;
    server.put("fits", vec![7; limit]);
    server.put("chunks", vec![7; limit]);
    server.put("large", vec![7; limit + 1]);
    let folder = HttpFolder::new(patient(0), &server.url(""));
    assert_eq!(folder.read("fits").unwrap().len(), limit);
    for path in ["chunks", "large"] {
        let reason = reason(&folder.read(path).unwrap_err());
        assert!(reason.contains("more than 32 MiB"), "{reason}");
    }
}

#[test]
fn promises_of_huge_files_take_no_memory() {
    let huge = || Fault::Header("Content-Length", u64::MAX.to_string());
    let server = server(move |_| huge());
    let error = HttpFolder::new(patient(0), &server.url("")).read("file");
    assert!(error.is_err());
    // More than there are addresses, so that no system grants it.
    let liar = HttpServer::with_faults(always(Fault::Promise(1 << 60)));
    liar.put("file", bytes(100, 0));
    let file = HttpRange::new(patient(0), liar.url("file"));
    let error = file.read_at(0, 1 << 60).unwrap_err();
    assert!(matches!(error, RangeError::Short { .. }), "{error:?}");
}

#[test]
fn a_folder_on_the_disk_is_served_as_it_is() {
    let disk = tempfile::tempdir().unwrap();
    std::fs::create_dir(disk.path().join("tile")).unwrap();
    std::fs::write(disk.path().join("tile/file"), bytes(5000, 4)).unwrap();
    let server = HttpServer::of_folder(disk.path(), |_| Fault::None);
    let folder = HttpFolder::new(patient(0), &server.url(""));
    assert_eq!(folder.read("tile/file").unwrap(), bytes(5000, 4));
    let file = HttpRange::new(patient(0), server.url("tile/file"));
    assert_eq!(file.read_at(4000, 1000).unwrap(), bytes(5000, 4)[4000..]);
    assert!(matches!(
        folder.read("tile"),
        Err(RangeError::Missing { .. })
    ));
}

#[test]
fn bytes_that_change_on_the_way_are_left_to_checksums() {
    let server = server(always(Fault::Corrupt(3)));
    let file = HttpRange::new(patient(0), server.url("file"));
    let mut expected = bytes(5000, 0)[100..150].to_vec();
    expected[3] ^= 1;
    assert_eq!(file.read_at(100, 50).unwrap(), expected);
}

#[test]
fn a_server_ends_although_somebody_waits_for_it() {
    for fault in [
        Fault::Never,
        Fault::Delay(Duration::from_secs(3600)),
        Fault::Trickle { bytes_per_s: 1 },
    ] {
        let server = server(always(fault));
        let file = HttpRange::new(patient(0), server.url("file"));
        let waiting = thread::spawn(move || file.read_at(0, 50));
        while server.requests() == 0 {
            thread::yield_now();
        }
        drop(server);
        assert!(waiting.join().unwrap().is_err());
    }
}

/// `cargo test --release --no-default-features --features http --test http_sources -- --ignored
/// --nocapture`
#[test]
#[ignore = "prints figures"]
fn requests_per_second_on_the_loopback_interface() {
    let server = HttpServer::new();
    server.put("archive", bytes(64 << 20, 5));
    for length in [44 << 10, 15 << 10] {
        for threads in [1, 16] {
            let file = HttpRange::new(
                HttpClient::new(&HttpSettings::default()),
                server.url("archive"),
            );
            let connections = server.connections();
            let reads = 8000 / threads;
            let begun = Instant::now();
            let mut times: Vec<Duration> = thread::scope(|scope| {
                let readers: Vec<_> = (0..threads)
                    .map(|thread| {
                        let file = &file;
                        scope.spawn(move || {
                            let mut random = Random(thread + 1);
                            let time = |_| {
                                let first = random.below((64 << 20) - length) as u64;
                                let begun = Instant::now();
                                file.read_at(first, length as usize).unwrap();
                                begun.elapsed()
                            };
                            (0..reads).map(time).collect::<Vec<_>>()
                        })
                    })
                    .collect();
                let times = readers
                    .into_iter()
                    .flat_map(|reader| reader.join().unwrap());
                times.collect()
            });
            let seconds = begun.elapsed().as_secs_f64();
            times.sort_unstable();
            println!(
                "{} KiB, {threads} threads: {:.0} requests/s, median {:?}, 99th percentile {:?}, \
                 {} connections",
                length >> 10,
                times.len() as f64 / seconds,
                times[times.len() / 2],
                times[times.len() * 99 / 100],
                server.connections() - connections,
            );
        }
    }
}
