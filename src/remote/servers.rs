//! Shared caches on real servers: S3 and servers with its protocol, folders, and plain HTTP for reading. The only file
//! that names `object_store` and its asynchronous runtime; threads wait here for one request each.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::Path as FilePath;
use std::time::Duration;

use futures_util::{StreamExt, TryStreamExt};
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey, S3ConditionalPut};
use object_store::http::HttpBuilder;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{ClientOptions, Error, ObjectStore, ObjectStoreExt, PutMode, PutPayload, RetryConfig};
use tokio::runtime::Runtime;

use super::wire::{Fault, Wire, WireError};
use super::{Address, RemoteError};
use crate::fsx;

/// Larger contents are uploaded in parts, so that they need not be in memory as a whole.
const WHOLE: u64 = 16 << 20;
/// The least length of a part. S3 takes at most 10,000 of them.
const PART: u64 = 8 << 20;
/// A connection that is slower than this many bytes a second counts as one on which nothing moves.
const SLOWEST: u64 = 32 << 10;
/// How long connecting may take.
const CONNECT: Duration = Duration::from_secs(5);

struct Server {
    runtime: Runtime,
    store: Box<dyn ObjectStore>,
    prefix: String,
    timeout: Duration,
    read_only: bool,
}

/// The server of an address.
pub(super) fn connect(address: &Address) -> Result<Box<dyn Wire>, RemoteError> {
    let wrong = |why: String| RemoteError::Url { url: without_secrets(&address.url), why };
    let Some((scheme, rest)) = address.url.split_once("://") else {
        return Err(wrong(
            "expected `s3://bucket/prefix`, `file:///folder` or `https://host/path`".to_owned(),
        ));
    };
    if rest.split('/').next().is_some_and(|host| host.contains('@')) {
        return Err(wrong("a name or password does not belong in it; use the environment".to_owned()));
    }
    // Where another part of the program chose a provider of TLS already, that one is as good.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let (store, prefix): (Box<dyn ObjectStore>, &str) = match scheme {
        "s3" => {
            let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
            (Box::new(s3(bucket, &address.variables).map_err(wrong)?), prefix)
        }
        "file" => (Box::new(folder(rest, wrong)?), ""),
        "http" | "https" => {
            let options = client_options().with_allow_http(true);
            let builder = HttpBuilder::new().with_url(address.url.trim_end_matches('/'));
            let built = builder.with_client_options(options).with_retry(no_retry()).build();
            (Box::new(built.map_err(|error| wrong(error.to_string()))?), "")
        }
        other => {
            return Err(wrong(format!("its scheme is `{other}`, expected `s3`, `file`, `http` or `https`")));
        }
    };
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|error| wrong(format!("no threads for it: {error}")))?;
    let read_only = scheme.starts_with("http");
    let prefix = prefix.trim_matches('/').to_owned();
    Ok(Box::new(Server { runtime, store, prefix, timeout: address.timeout, read_only }))
}

/// A URL as it may be printed.
fn without_secrets(url: &str) -> String {
    match (url.find("://"), url.rfind('@')) {
        (Some(start), Some(at)) if at > start => format!("{}://…{}", &url[..start], &url[at..]),
        _ => url.to_owned(),
    }
}

/// Time limits and second tries are ours, for all servers alike.
fn client_options() -> ClientOptions {
    ClientOptions::new().with_timeout_disabled().with_read_timeout_disabled().with_connect_timeout(CONNECT)
}

fn no_retry() -> RetryConfig {
    RetryConfig { max_retries: 0, ..RetryConfig::default() }
}

fn s3(bucket: &str, variables: &BTreeMap<String, String>) -> Result<object_store::aws::AmazonS3, String> {
    if bucket.is_empty() {
        return Err("it names no bucket, expected `s3://bucket/prefix`".to_owned());
    }
    let mut builder = AmazonS3Builder::new().with_bucket_name(bucket).with_retry(no_retry());
    let mut options = client_options();
    for (name, value) in variables {
        if let Ok(key) = name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>()
            && !matches!(key, AmazonS3ConfigKey::Client(_))
        {
            builder = builder.with_config(key, value);
        }
        // Naming such an endpoint is a choice; AWS itself is never reached without TLS.
        if name.starts_with("AWS_ENDPOINT") && value.starts_with("http://") {
            options = options.with_allow_http(true);
        }
    }
    builder
        .with_client_options(options)
        .with_conditional_put(S3ConditionalPut::ETagMatch)
        .build()
        .map_err(|error| error.to_string())
}

/// `rest` is what follows `file://`: an absolute path. A folder that is not there may be one that is not mounted.
fn folder(rest: &str, wrong: impl Fn(String) -> RemoteError) -> Result<LocalFileSystem, RemoteError> {
    if !rest.starts_with('/') {
        return Err(wrong("expected an absolute path, as in `file:///srv/cache`".to_owned()));
    }
    let path = FilePath::new(rest);
    match fsx::real(path).map(|path| fsx::entry(&path)) {
        Some(Ok(Some(fsx::Entry::Folder))) => {}
        Some(Ok(Some(_))) => return Err(wrong("it is no folder".to_owned())),
        Some(Err(error)) => return Err(RemoteError::NoAnswer(error.to_string())),
        Some(Ok(None)) | None => {
            let text = format!("there is no folder `{rest}`; make it, or mount what should be there");
            return Err(RemoteError::NoAnswer(text));
        }
    }
    let store = LocalFileSystem::new_with_prefix(path).map_err(|error| wrong(error.to_string()))?;
    Ok(store.with_fsync(true))
}

impl Server {
    fn path(&self, name: &str) -> Path {
        if self.prefix.is_empty() { Path::from(name) } else { Path::from(format!("{}/{name}", self.prefix)) }
    }

    /// Waits for a request that moves at most so many bytes before it answers.
    fn wait<T>(
        &self,
        bytes: u64,
        request: impl Future<Output = object_store::Result<T>>,
    ) -> Result<T, Refusal> {
        let limit = self.timeout + Duration::from_secs(bytes / SLOWEST);
        match self.runtime.block_on(async { tokio::time::timeout(limit, request).await }) {
            Ok(answer) => answer.map_err(Refusal::from),
            Err(_) => {
                let text = format!("no answer within {} s", limit.as_secs());
                Err(Refusal::Other(WireError::new(Fault::Transient, text)))
            }
        }
    }

    fn upload_parts(
        &self,
        name: &str,
        file: &mut fsx::File,
        length: u64,
        accept: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<(), WireError> {
        let part = PART.max(length / 9_000 + 1);
        let path = self.path(name);
        let mut upload = self.wait(0, self.store.put_multipart(&path))?;
        let sent = (|| {
            let mut sent = 0;
            loop {
                let bytes = read(file, part)?;
                sent += bytes.len() as u64;
                if bytes.is_empty() {
                    break;
                }
                if !accept(&bytes) {
                    return Err(not_accepted());
                }
                self.wait(bytes.len() as u64, upload.put_part(bytes.into()))?;
            }
            if sent != length || !accept(&[]) {
                return Err(not_accepted());
            }
            self.wait(0, upload.complete())?;
            Ok(())
        })();
        if sent.is_err() {
            // What stays behind where this fails, too, is invisible; buckets can be set to remove it.
            let _ = self.wait(0, upload.abort());
        }
        sent
    }
}

fn read(file: &mut fsx::File, most: u64) -> Result<Vec<u8>, WireError> {
    let mut bytes = Vec::new();
    match file.take(most).read_to_end(&mut bytes) {
        Ok(_) => Ok(bytes),
        Err(error) => Err(WireError::new(Fault::Object, error.to_string())),
    }
}

fn not_accepted() -> WireError {
    WireError::new(Fault::Object, "the file is not what it should be")
}

impl Wire for Server {
    fn get(&self, name: &str, into: &mut dyn Write, limit: u64) -> Result<Option<u64>, WireError> {
        let path = self.path(name);
        let found = match self.wait(0, self.store.get(&path)) {
            Err(Refusal::Absent) => return Ok(None),
            found => found?,
        };
        let mut stream = found.into_stream();
        let mut length = 0;
        while let Some(chunk) = self.wait(0, async { stream.next().await.transpose() })? {
            length += chunk.len() as u64;
            if length > limit {
                return Err(WireError::new(
                    Fault::Object,
                    format!("it is longer than the {limit} B expected"),
                ));
            }
            into.write_all(&chunk).map_err(|error| WireError::new(Fault::Object, error.to_string()))?;
        }
        Ok(Some(length))
    }

    fn size(&self, name: &str) -> Result<Option<u64>, WireError> {
        match self.wait(0, self.store.head(&self.path(name))) {
            Err(Refusal::Absent) => Ok(None),
            found => Ok(Some(found?.size)),
        }
    }

    fn create(&self, name: &str, bytes: Vec<u8>) -> Result<bool, WireError> {
        let length = bytes.len() as u64;
        let path = self.path(name);
        let put = self.store.put_opts(&path, PutPayload::from(bytes), PutMode::Create.into());
        match self.wait(length, put) {
            Err(Refusal::Exists) => Ok(false),
            done => done.map(|_| true).map_err(WireError::from),
        }
    }

    fn upload(
        &self,
        name: &str,
        file: &FilePath,
        length: u64,
        accept: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<(), WireError> {
        let mut file = fsx::open(file).map_err(|error| WireError::new(Fault::Object, error.to_string()))?;
        if length > WHOLE {
            return self.upload_parts(name, &mut file, length, accept);
        }
        let bytes = read(&mut file, length + 1)?;
        if bytes.len() as u64 != length || !bytes.is_empty() && !accept(&bytes) || !accept(&[]) {
            return Err(not_accepted());
        }
        self.wait(length, self.store.put(&self.path(name), bytes.into()))?;
        Ok(())
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, WireError> {
        if self.read_only {
            let text = "a plain HTTP server cannot list what it has; name the results by a pipeline file";
            return Err(WireError::new(Fault::Object, text));
        }
        let path = self.path(folder);
        let cut = if self.prefix.is_empty() { 0 } else { self.path("").as_ref().len() + 1 };
        let mut stream = self.store.list(Some(&path));
        let mut names = Vec::new();
        // Many pages, each in its own time.
        while let Some(object) = self.wait(0, stream.try_next())? {
            names.extend(object.location.as_ref().get(cut..).map(str::to_owned));
        }
        Ok(names)
    }

    fn is_read_only(&self) -> bool {
        self.read_only
    }
}

/// How a server refuses.
enum Refusal {
    Absent,
    Exists,
    Other(WireError),
}

impl From<Error> for Refusal {
    fn from(error: Error) -> Self {
        let text = in_one_line(&error);
        match error {
            Error::NotFound { .. } if text.contains("NoSuchBucket") => {
                Self::Other(WireError::new(Fault::Permanent, format!("there is no such bucket: {text}")))
            }
            Error::NotFound { .. } => Self::Absent,
            Error::AlreadyExists { .. } | Error::Precondition { .. } => Self::Exists,
            Error::PermissionDenied { .. }
            | Error::Unauthenticated { .. }
            | Error::NotSupported { .. }
            | Error::NotImplemented { .. }
            | Error::InvalidPath { .. }
            | Error::UnknownConfigurationKey { .. } => Self::Other(WireError::new(Fault::Permanent, text)),
            _ => Self::Other(WireError::new(Fault::Transient, text)),
        }
    }
}

impl From<Refusal> for WireError {
    fn from(refusal: Refusal) -> Self {
        match refusal {
            Refusal::Absent => Self::new(Fault::Permanent, "there is no such bucket or folder"),
            Refusal::Exists => Self::new(Fault::Transient, "another writer was faster"),
            Refusal::Other(error) => error,
        }
    }
}

/// An error with all its causes, each said once.
fn in_one_line(error: &Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        let more = error.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = error.source();
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
