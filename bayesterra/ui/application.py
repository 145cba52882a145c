"""Application: what the page answers, each answer made by the functions of the other rooms."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from bayesterra.errors import BayesterraError, StudyError, in_short, printable
from bayesterra.report.sections import render
from bayesterra.report.verdicts import SIGNS
from bayesterra.ui.folder import SAVED, Entry, Folder, checked_entry, write_record
from bayesterra.ui.guard import MOST_BODY, REPORT_POLICY, Address, Guard
from bayesterra.ui.jobs import RUNNING, VERBS, Job, Queue

if TYPE_CHECKING:
    from bayesterra.study.study import Study
    from bayesterra.ui.draft import Draft
    from bayesterra.ui.what_if import WhatIf

PACKAGE = "bayesterra.ui"
HERE = Path(__file__).parent
STYLE = HERE.parent / "report" / "templates" / "style.css"
KINDS = {
    ".html": "text/html; charset=utf-8", ".png": "image/png",
    **dict.fromkeys((".csv", ".toml", ".txt", ".json"), "text/plain; charset=utf-8"),
}  # fmt: skip
"""Kinds of the files of results that are served."""
KEPT_RESULTS = 4
MOST_FIELDS = 2000
Form = dict[str, str]


@dataclass(frozen=True)
class Upload:
    """A file that came with a form."""

    name: str
    content: bytes


class Site:
    """The page of one folder."""

    def __init__(self, folder: Folder) -> None:
        self.folder, self.queue = folder, Queue(folder)
        self._results: OrderedDict[tuple[str, int], WhatIf] = OrderedDict()

    # What every answer needs

    def page(self, template: str, title: str, **content: Any) -> HTMLResponse:
        """A whole page."""
        shown = SimpleNamespace(title=title, version=version("bayesterra"), folder=self.folder.root.name, content=None)
        vars(shown).update(content)
        return HTMLResponse(render(shown, template, PACKAGE))

    def part(self, template: str, status: int = 200, **content: Any) -> HTMLResponse:
        """A part of a page, which takes the place of an older one."""
        return HTMLResponse(render(SimpleNamespace(**content), template, PACKAGE), status)

    def refused(self, request: Request, message: str, status: int) -> Response:
        """An error for people, in the page."""
        if request.headers.get("hx-request"):
            return self.part("error.html", status, message=message)
        page = self.page("refused.html", "Not possible", message=message)
        page.status_code = status
        return page

    # Home: studies, results, jobs

    async def home(self, request: Request) -> Response:
        """First page."""
        return self.page("home.html", "Studies and results")

    async def lists(self, request: Request) -> Response:
        """Studies and results in the folder."""
        folder = self.folder
        studies, results, drafts = await run_in_threadpool(
            lambda: (folder.studies(), folder.results(), folder.drafts())
        )
        return self.part(
            "lists.html", studies=studies, drafts=drafts, results=[shown_result(entry) for entry in results]
        )

    async def jobs(self, request: Request) -> Response:
        """The queue, and how far each job is."""
        return self.part("jobs.html", jobs=self._jobs(), seen=self.queue.states)

    async def progress(self, request: Request) -> Response:
        """How far jobs at work are, in their places in the list; word where the list itself has changed."""
        answer = self.part("progress.html", jobs=self._jobs())
        if request.query_params.get("seen") != self.queue.states:
            answer.headers["HX-Trigger"] = "jobs-changed"
        return answer

    def _jobs(self) -> list[SimpleNamespace]:
        queue = self.queue
        return [
            SimpleNamespace(
                job=job, progress=queue.progress(job) if job.state == RUNNING else None, saved=queue.saved(job)
            )
            for job in reversed(queue.jobs)
        ]  # fmt: skip

    async def add_job(self, request: Request) -> Response:
        """Put a run, a comparison or a design into the queue."""
        form, _ = await received(request)
        job = await run_in_threadpool(self._job, form)
        self.queue.add(job)
        return RedirectResponse("/#jobs", 303)

    def _job(self, form: Form) -> Job:
        verb, names = form.get("verb", ""), [name for key, name in form.items() if key.startswith("subject") and name]
        if verb == "compare":
            if len(names) < 2 or len(set(names)) < len(names):
                raise StudyError("choose two different results to compare")
            out = f"{names[0]}-and-{names[1]}"[:60]
        elif len(names) != 1:
            raise StudyError("choose a study or a result first")
        else:
            out = f"{names[0].removesuffix('.toml').removesuffix('-result')}-{VERBS.get(verb, 'result')}"
        for name in names:
            self.folder.opened(name)
        options = [f"--{key}={form[key].strip()}" for key in ("seed", "number") if form.get(key, "").strip()]
        options += ["--prior-only"] if form.get("prior-only") else []
        job = Job(verb, tuple(names), self.folder.free(out), tuple(options))
        job.command(self.folder)
        return job

    async def change_job(self, request: Request) -> Response:
        """Stop a job, let it go on, or take it from the list."""
        number, change = request.path_params["number"], request.path_params["change"]
        changes = {"stop": self.queue.stop, "resume": self.queue.resume, "forget": self.queue.forget}
        if change not in changes:
            raise HTTPException(404, "there is no such change of a job")
        changes[change](number)
        return await self.jobs(request)

    # A study: from a table to a folder

    async def begin(self, request: Request) -> Response:
        """Take a table, and show the form of the study that it belongs to."""
        form, uploads = await received(request)
        upload = one_file(uploads)
        number = await run_in_threadpool(self._begin, upload, form.get("kind", "wheel"))
        return RedirectResponse(f"/draft/{number}", 303)

    def _begin(self, upload: Upload, kind: str = "wheel") -> str:
        from bayesterra.ui.draft import Draft

        folder = self.folder.begin_draft()
        Draft.begun(folder, upload.name, upload.content, kind)
        return folder.name

    async def copy(self, request: Request) -> Response:
        """Open a study of the folder as a new one."""
        number = await run_in_threadpool(self._copy, request.path_params["name"])
        return RedirectResponse(f"/draft/{number}", 303)

    def _copy(self, name: str) -> str:
        from bayesterra.ui.draft import Draft

        path = self.folder.opened(name)
        folder = self.folder.begin_draft()
        Draft.copied(path, folder)
        return folder.name

    def _draft(self, request: Request) -> Draft:
        from bayesterra.ui.draft import Draft

        return Draft.at(self.folder.draft(request.path_params["number"]))

    async def draft(self, request: Request) -> Response:
        """The form of a study in the making."""
        return await run_in_threadpool(self._draft_page, request)

    def _draft_page(self, request: Request) -> Response:
        from bayesterra.ui.form import form_of

        draft = self._draft(request)
        return self.page("draft.html", "A study", form=form_of(draft), number=draft.folder.name, text=draft.text)

    async def change_draft(self, request: Request) -> Response:
        """Take the form in, and say what is understood of it."""
        form, _ = await received(request)
        return await run_in_threadpool(self._change_draft, request, form)

    def _change_draft(self, request: Request, form: Form) -> Response:
        draft = self._draft(request)
        draft.fill(form)
        if add := form.get("add", ""):
            draft.add(add)
            return RedirectResponse(f"/draft/{draft.folder.name}#{add}s", 303)
        return self._understood(draft)

    async def check_draft(self, request: Request) -> Response:
        """What is understood of the study as it stands."""
        return await run_in_threadpool(lambda: self._understood(self._draft(request)))

    def _understood(self, draft: Draft) -> Response:
        from bayesterra.ui.check import checked, laws

        return self.part(
            "check.html",
            **checked(self.folder, draft.folder),
            laws=laws(draft.priors()),
            place=f"/draft/{draft.folder.name}",
        )

    async def rewrite_draft(self, request: Request) -> Response:
        """Take the text of the study file in, as it was typed."""
        form, _ = await received(request)

        def rewritten() -> str:
            draft = self._draft(request)
            draft.rewrite(form.get("text", ""))
            return draft.folder.name

        return RedirectResponse(f"/draft/{await run_in_threadpool(rewritten)}", 303)

    async def attach(self, request: Request) -> Response:
        """Add soil tests to a study."""
        form, uploads = await received(request)

        def attached() -> str:
            draft, upload = self._draft(request), one_file(uploads)
            draft.attach(upload.name, upload.content, form.get("test", ""))
            return draft.folder.name

        return RedirectResponse(f"/draft/{await run_in_threadpool(attached)}#tests", 303)

    async def prior_of_draft(self, request: Request) -> Response:
        """What the prior predicts of the rows, before any run."""
        return await run_in_threadpool(lambda: self._prior(self._draft(request).folder))

    async def prior_of_study(self, request: Request) -> Response:
        """The same of a study that is saved."""
        return await run_in_threadpool(lambda: self._prior(self.folder.opened(request.path_params["name"])))

    def _prior(self, path: Path) -> Response:
        from bayesterra.analysis.inference import run_prior
        from bayesterra.ui.check import loaded
        from bayesterra.ui.picture import prior_panels

        prior = run_prior(loaded(self.folder, path, prior_only=True))
        return self.part("prior.html", panels=prior_panels(prior), overview=prior.overview())

    async def discard_draft(self, request: Request) -> Response:
        """Remove a draft, and show what is left."""
        await run_in_threadpool(self.folder.discard_draft, request.path_params["number"])
        return await self.lists(request)

    async def save_draft(self, request: Request) -> Response:
        """Make a folder of the study, which the command line opens as well."""
        form, _ = await received(request)
        name = await run_in_threadpool(self._save, request, form)
        return RedirectResponse(f"/study/{quote(name)}", 303)

    def _save(self, request: Request, form: Form) -> str:
        from bayesterra.ui.check import loaded

        draft = self._draft(request)
        loaded(self.folder, draft.folder)  # a study that cannot be read is not saved
        name = checked_entry(form.get("name", ""))
        self.folder.write_all(name, draft.files())
        write_record(draft.folder / SAVED, f"{name}\n")
        return name

    async def study(self, request: Request) -> Response:
        """A study as the command ``check`` shows it, and its run."""
        return await run_in_threadpool(self._study, request.path_params["name"])

    def _study(self, name: str) -> Response:
        from bayesterra.ui.check import checked, laws

        path = self.folder.opened(name)
        shown = checked(self.folder, path)
        study: Study | None = shown["study"]
        entries = study.prior.entries if study else {}
        kind = "soiltest" if (path / "soiltest.toml").is_file() else "run"
        return self.page(
            "study.html",
            study.title if study and study.title else name,
            name=name,
            verb=kind,
            laws=laws(entries),
            place=f"/study/{quote(name)}",
            **shown,
        )

    # A log: from samples to rows

    async def begin_log(self, request: Request) -> Response:
        """Take a log, and show its windows."""
        _, uploads = await received(request)
        upload = one_file(uploads)
        number = await run_in_threadpool(self.folder.keep_upload, upload.name, upload.content)
        return RedirectResponse(f"/logs/{number}", 303)

    async def log(self, request: Request) -> Response:
        """A log with the windows that are found."""

        def shown() -> Response:
            number, path = request.path_params["number"], self.folder.upload(request.path_params["number"])
            content = self._reduced(number, {})
            return self.page("log.html", f"Log {path.name}", number=number, suggested=path.stem[:60], **content)

        return await run_in_threadpool(shown)

    async def change_log(self, request: Request) -> Response:
        """The same with other settings, and windows where they were moved to."""
        form, _ = await received(request)
        number = request.path_params["number"]
        return await run_in_threadpool(lambda: self.part("reduced_log.html", **self._reduced(number, form)))

    def _reduced(self, number: str, form: Form) -> dict[str, Any]:
        from bayesterra.ui.reduction import Reduced

        path = self.folder.upload(number)
        try:
            reduced = Reduced.of(path, form)
        except BayesterraError as error:
            message = (
                str(error)
                .replace(f"{path}: ", "")
                .replace(' --radius "58 mm"', " above")
                .replace('--plate "100 mm"', "give it above")
            )
            return {"reduced": None, "error": message, "panels": (), "overview": (), "form": form}
        return {"reduced": reduced, "error": "", "panels": reduced.panels(), "overview": reduced.overview()}

    async def save_log(self, request: Request) -> Response:
        """Write the rows as a table with its page; of drives begin a study."""
        form, _ = await received(request)
        return RedirectResponse(await run_in_threadpool(self._save_log, request.path_params["number"], form), 303)

    def _save_log(self, number: str, form: Form) -> str:
        from bayesterra.ui.reduction import Reduced

        reduction = Reduced.of(self.folder.upload(number), form).reduction
        path = self.folder.root / checked_entry(f"{form.get('name', '').strip()}.csv")
        self.folder.inside(path)
        reduction.save(path)
        if reduction.branches:
            return "/"
        return f"/draft/{self._begin(Upload(path.name, self.folder.content(path.name)))}"

    # A result

    async def result(self, request: Request) -> Response:
        """First screen of a result, and its report as it is."""
        return await run_in_threadpool(self._result, request.path_params["name"])

    def _result(self, name: str) -> Response:
        self.folder.opened(name)
        entries = [entry for entry in self.folder.results() if entry.name == name]
        if not entries:
            raise StudyError(f"'{name}' holds no finished result")
        others = [entry.name for entry in self.folder.results() if entry.kind == "result" and entry.name != name]
        files = sorted(each.name for each in self.folder.named(name).iterdir() if each.suffix in KINDS)
        return self.page(
            "result.html", entries[0].title or name, entry=shown_result(entries[0]), others=others, files=files
        )

    async def file(self, request: Request) -> Response:
        """A file of a result; pages run no script, whatever stands in them."""
        name, file = request.path_params["name"], request.path_params["file"]
        kind = KINDS.get(Path(file).suffix)
        if kind is None:
            raise HTTPException(404, "files of this kind are not shown: open the folder itself")
        content = await run_in_threadpool(self.folder.served, name, file)
        return Response(content, headers={"Content-Type": kind, "Content-Security-Policy": REPORT_POLICY})

    async def what_if(self, request: Request) -> Response:
        """Sliders of a result, or of two side by side."""
        return await run_in_threadpool(
            self._what_if, request.path_params["name"], request.query_params.get("beside", "")
        )

    def _what_if(self, name: str, beside: str) -> Response:
        first = self.held(name)
        others = [entry.name for entry in self.folder.results() if entry.kind == "result" and entry.name != name]
        shown = self._answers(first, beside, {})
        return self.page(
            "what_if.html",
            f"What if: {first.study.title or name}",
            name=name,
            beside=beside,
            others=others,
            held=first,
            **shown,
        )

    async def bands(self, request: Request) -> Response:
        """Bands where the sliders stand."""
        form, _ = await received(request)
        first, beside = request.path_params["name"], form.get("beside", "")
        shown = await run_in_threadpool(lambda: self._answers(self.held(first), beside, form))
        return self.part("bands.html", **shown)

    def _answers(self, first: WhatIf, beside: str, form: Mapping[str, str]) -> dict[str, Any]:
        from bayesterra.ui.what_if import widest

        setting = first.checked(form)
        settings = [(first, setting)]
        if beside:
            second = self.held(beside)
            settings.append((second, second.checked({**form, "wheel": setting.wheel})))
        scales = widest([held.scales(each) for held, each in settings])
        return {"setting": setting, "answers": [(held.name, held.answer(each, scales)) for held, each in settings]}

    def held(self, name: str) -> WhatIf:
        """A result with its draws ready, from memory where it was opened before and has not changed since."""
        from bayesterra.analysis.run import load_result
        from bayesterra.ui.what_if import WhatIf

        path = self.folder.opened(name)
        key = name, path.stat().st_mtime_ns
        if key not in self._results:
            self._results[key] = WhatIf(name, load_result(path))
            while len(self._results) > KEPT_RESULTS:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]


def shown_result(entry: Entry) -> SimpleNamespace:
    """A result with its sentence and verdicts, as its record has them."""
    record = entry.record or {}
    verdicts = record.get("verdicts")
    cards = [
        {**{key: str(each.get(key, "")) for key in ("name", "word", "sentence")}, "grade": grade, "sign": SIGNS[grade]}
        for each in (verdicts if isinstance(verdicts, list) else ())
        if isinstance(each, dict) and (grade := str(each.get("grade"))) in SIGNS
    ]
    grades = {card["grade"] for card in cards}
    worst = next((grade for grade in ("bad", "doubtful") if grade in grades), "good")
    sentence = record.get("sentence")
    return SimpleNamespace(
        name=entry.name, kind=entry.kind, title=entry.title, page=entry.page, cards=cards, grade=worst,
        made=str(record.get("made", ""))[:16].replace("T", " "),
        sentence=sentence if isinstance(sentence, str) else "",
    )  # fmt: skip


async def received(request: Request) -> tuple[Form, dict[str, Upload]]:
    """Texts and files of a form; of several values of one name the last."""
    texts: Form = {}
    uploads: dict[str, Upload] = {}
    async with request.form(max_files=8, max_fields=MOST_FIELDS, max_part_size=4 * 2**20) as form:
        for key, value in form.multi_items():
            if isinstance(value, UploadFile):
                if value.filename:
                    uploads[key] = Upload(Path(value.filename.replace("\\", "/")).name, await value.read())
            else:
                texts[key] = value
    return texts, uploads


def one_file(uploads: Mapping[str, Upload]) -> Upload:
    """The file that was sent; StudyError where there is none."""
    if len(uploads) != 1:
        raise StudyError("choose a file with a table first: CSV, Excel or Parquet")
    return next(iter(uploads.values()))


def application(folder: Folder, address: Address, most: int = MOST_BODY) -> tuple[Guard, Site]:
    """The page of a folder behind its guard, and the site itself."""
    site = Site(folder)

    async def said(request: Request, error: Exception) -> Response:
        return site.refused(request, str(error), 422)

    async def http(request: Request, error: Exception) -> Response:
        status = error.status_code if isinstance(error, HTTPException) else 500
        detail = error.detail if isinstance(error, HTTPException) else str(error)
        text = "There is no such page here." if status == 404 and detail == "Not Found" else detail
        return site.refused(request, text, status)

    async def bug(request: Request, error: Exception) -> Response:
        said = in_short(printable(str(error)), 300)
        return site.refused(
            request, f"This is a bug in bayesterra ({type(error).__name__}: {said}): please report it.", 500
        )

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        work = asyncio.create_task(site.queue.work())
        Thread(target=_warm, daemon=True).start()
        try:
            yield
        finally:
            await site.queue.close()
            work.cancel()
            with suppress(asyncio.CancelledError):
                await work

    async def style(request: Request) -> Response:
        return FileResponse(STYLE, media_type="text/css")

    def get(path: str, answer: Callable[[Request], Awaitable[Response]]) -> Route:
        return Route(path, answer, methods=["GET"])

    def post(path: str, answer: Callable[[Request], Awaitable[Response]]) -> Route:
        return Route(path, answer, methods=["POST"])

    routes = [
        get("/", site.home), get("/lists", site.lists), get("/jobs", site.jobs),
        get("/progress", site.progress), post("/jobs", site.add_job),
        post("/jobs/{number}/{change}", site.change_job), post("/tables", site.begin),
        get("/draft/{number}", site.draft), post("/draft/{number}", site.change_draft),
        get("/draft/{number}/check", site.check_draft), post("/draft/{number}/text", site.rewrite_draft),
        post("/draft/{number}/tests", site.attach), post("/draft/{number}/prior", site.prior_of_draft),
        post("/draft/{number}/save", site.save_draft), post("/draft/{number}/discard", site.discard_draft),
        get("/study/{name}", site.study),
        post("/study/{name}/prior", site.prior_of_study), post("/study/{name}/copy", site.copy),
        post("/logs", site.begin_log), get("/logs/{number}", site.log), post("/logs/{number}", site.change_log),
        post("/logs/{number}/rows", site.save_log), get("/result/{name}", site.result),
        get("/what-if/{name}", site.what_if), post("/what-if/{name}", site.bands),
        get("/files/{name}/{file}", site.file), get("/static/report.css", style),
        Mount("/static", StaticFiles(directory=HERE / "static")),
    ]  # fmt: skip
    handlers: dict[Any, Any] = {BayesterraError: said, OSError: said, HTTPException: http, Exception: bug}
    return Guard(
        Starlette(routes=routes, exception_handlers=handlers, lifespan=lifespan), address=address, most=most
    ), site


def _warm() -> None:
    """Import what the first check needs, while the reader looks at the first page."""
    for name in ("bayesterra.ui.check", "bayesterra.ui.form", "bayesterra.likelihood.page", "bayesterra.analysis.run"):
        import_module(name)
