BEGIN TRANSACTION;
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num)
);
INSERT INTO "alembic_version" VALUES('0001');
CREATE TABLE artifact (
	digest VARCHAR(64) NOT NULL, 
	size BIGINT NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	created FLOAT NOT NULL, 
	CONSTRAINT pk_artifact PRIMARY KEY (digest)
);
INSERT INTO "artifact" VALUES('8d1cf47c3fc35297e655a28e1a80de178fdf5767427c10665d21c773c8779fb8',3418,'live',1.79545282509644722941e+09);
INSERT INTO "artifact" VALUES('5d634ad1bfe0378a14b5753da067584683d132f68a88e6765e276542e6c7de33',68,'live',1.7954528253893625736e+09);
INSERT INTO "artifact" VALUES('2c0ac9664f288185a71f589f0f8f646d5d89dd7f8f59db2f93c0a80bfb0e7e5f',2048,'live',1.7954528253893625736e+09);
INSERT INTO "artifact" VALUES('98b25374b0adef3c71b61771a49dc2b0549ca6f2406f61cdab2ea50c6c0828fc',406,'live',1.7954528253893625736e+09);
INSERT INTO "artifact" VALUES('d4dc56669143034f31aa309635d4113d9ad76a02b1739da22c965ed2049be9e6',6,'live',1.7954528253893625736e+09);
INSERT INTO "artifact" VALUES('856f319b357c9fc2314a09d1970584f22fe7f9f92b3ca18cd5206c3cdcb1009b',10684,'deleting',1.79545282627434396745e+09);
INSERT INTO "artifact" VALUES('34d474b02642d58dba587ddde454ec9ae0e0ad33ff44ac3150b96c1b3bef2993',7526,'deleting',1.79545282670724320409e+09);
INSERT INTO "artifact" VALUES('fbe2f5b3204a7100340a007a4a9d0aa5f804b37c74a10629574c81b0c04934e0',3300,'deleting',1.79545282690746712682e+09);
INSERT INTO "artifact" VALUES('255ec2d6c79662eacd3613dd49dd863d13c796ec3756ecdbf70a88eeaa0f9072',6478,'live',1.79545282694457912445e+09);
INSERT INTO "artifact" VALUES('6ad93333a0ebb9f36a8a416a37493db6555a65a3d38e0a18f0a2307b42d8f20e',3709,'live',1.79545282695942854883e+09);
CREATE TABLE attempt (
	id INTEGER NOT NULL, 
	film_id INTEGER NOT NULL, 
	instance_id VARCHAR(36) NOT NULL, 
	child INTEGER NOT NULL, 
	chunks INTEGER NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	digest VARCHAR(64), 
	seconds FLOAT, 
	error_class VARCHAR(64), 
	error_message TEXT, 
	log_tail TEXT, 
	created FLOAT NOT NULL, 
	ended FLOAT, 
	lease_until FLOAT NOT NULL, 
	CONSTRAINT pk_attempt PRIMARY KEY (id), 
	CONSTRAINT fk_attempt_film_id FOREIGN KEY(film_id) REFERENCES film (id)
);
INSERT INTO "attempt" VALUES(1,1,'01a20953-eafe-7230-b889-484019fd7c74',16683,3,'merged','0a7a9d10ee3e313ee87a3d4e355df26332d4f87094cb31f8701ece28cbea5696',2.43012460050522349774e-02,NULL,NULL,NULL,1.79545282488696885106e+09,1.79545282499478030206e+09,1.79545285488696885114e+09);
INSERT INTO "attempt" VALUES(2,1,'01a20953-eafe-7230-b889-484019fd7c74',16683,2,'merged','77dbe6397f9f3373287a6f86b61af8c2199c697646873360173719df3682662b',2.94541001494508236646e-04,NULL,NULL,NULL,1.795452824895663023e+09,1.7954528250194804668e+09,1.795452854895663023e+09);
INSERT INTO "attempt" VALUES(3,1,'01a20953-eafe-7230-b889-484019fd7c74',16683,1,'merged','962909f41c3a1d4442b98a9bf91379aab0777b290bc9d06535848628295f07ca',2.55051003478001803159e-04,NULL,NULL,NULL,1.79545282500885200506e+09,1.79545282507037329668e+09,1.79545285500885200497e+09);
INSERT INTO "attempt" VALUES(4,2,'01a20953-eafe-7230-b889-484019fd7c74',16683,6,'failed',NULL,NULL,'python_error','RuntimeError: told to raise','Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
',1.79545282546933364863e+09,1.79545282552953863143e+09,1.79545285546933364867e+09);
INSERT INTO "attempt" VALUES(5,2,'01a20953-eafe-7230-b889-484019fd7c74',16683,6,'failed',NULL,NULL,'python_error','RuntimeError: told to raise','Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
',1795452825.54301,1.79545282558252167703e+09,1795452855.54301);
INSERT INTO "attempt" VALUES(6,2,'01a20953-eafe-7230-b889-484019fd7c74',16683,6,'failed',NULL,NULL,'python_error','RuntimeError: told to raise',')
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
',1.79545282559002423289e+09,1.79545282559792637819e+09,1.79545285559002423285e+09);
INSERT INTO "attempt" VALUES(7,4,'01a20953-eafe-7230-b889-484019fd7c74',16683,10,'merged','856f319b357c9fc2314a09d1970584f22fe7f9f92b3ca18cd5206c3cdcb1009b',5.40486881007382180541e-01,NULL,NULL,NULL,1.79545282570730423922e+09,1.7954528262731506824e+09,1.7954528557073042393e+09);
INSERT INTO "attempt" VALUES(8,4,'01a20953-eafe-7230-b889-484019fd7c74',16683,7,'merged','34d474b02642d58dba587ddde454ec9ae0e0ad33ff44ac3150b96c1b3bef2993',3.67682604999572504311e-01,NULL,NULL,NULL,1.79545282571531081197e+09,1.79545282670646786692e+09,1.795452855715310812e+09);
INSERT INTO "attempt" VALUES(9,4,'01a20953-eafe-7230-b889-484019fd7c74',16683,3,'merged','fbe2f5b3204a7100340a007a4a9d0aa5f804b37c74a10629574c81b0c04934e0',1.59840480999264400452e-01,NULL,NULL,NULL,1.79545282629175353052e+09,1.79545282690665435791e+09,1.79545285629175353052e+09);
INSERT INTO "attempt" VALUES(10,5,'01a20953-eafe-7230-b889-484019fd7c74',16683,6,'done','255ec2d6c79662eacd3613dd49dd863d13c796ec3756ecdbf70a88eeaa0f9072',2.99336999887600541114e-04,NULL,NULL,NULL,1.7954528267237365246e+09,1.79545282694377231593e+09,1.7954528567237365246e+09);
INSERT INTO "attempt" VALUES(11,6,'01a20953-eafe-7230-b889-484019fd7c74',16683,6,'running',NULL,NULL,NULL,NULL,NULL,1.79545282692789816853e+09,NULL,1.79545285692789816861e+09);
CREATE TABLE chunk (
	film_id INTEGER NOT NULL, 
	idx INTEGER NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	token INTEGER NOT NULL, 
	tries INTEGER NOT NULL, 
	losses INTEGER NOT NULL, 
	CONSTRAINT pk_chunk PRIMARY KEY (film_id, idx), 
	CONSTRAINT fk_chunk_film_id FOREIGN KEY(film_id) REFERENCES film (id)
);
INSERT INTO "chunk" VALUES(5,0,'done',10,0,0);
INSERT INTO "chunk" VALUES(5,1,'done',10,0,0);
INSERT INTO "chunk" VALUES(5,2,'done',10,0,0);
INSERT INTO "chunk" VALUES(5,3,'done',10,0,0);
INSERT INTO "chunk" VALUES(5,4,'done',10,0,0);
INSERT INTO "chunk" VALUES(5,5,'done',10,0,0);
INSERT INTO "chunk" VALUES(6,0,'claimed',11,0,0);
INSERT INTO "chunk" VALUES(6,1,'claimed',11,0,0);
INSERT INTO "chunk" VALUES(6,2,'claimed',11,0,0);
INSERT INTO "chunk" VALUES(6,3,'claimed',11,0,0);
INSERT INTO "chunk" VALUES(6,4,'claimed',11,0,0);
INSERT INTO "chunk" VALUES(6,5,'claimed',11,0,0);
CREATE TABLE event (
	seq INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	time FLOAT NOT NULL, 
	kind VARCHAR(32) NOT NULL, 
	job_id VARCHAR(36), 
	sweep_id VARCHAR(36), 
	data TEXT NOT NULL
);
INSERT INTO "event" VALUES(1,1.79545282486741161341e+09,'queued','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{"cached": false}');
INSERT INTO "event" VALUES(2,1.79545282488926959034e+09,'running','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{}');
INSERT INTO "event" VALUES(3,1.79545282500489544871e+09,'progress','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{"chunks": 3}');
INSERT INTO "event" VALUES(4,1.79545282502125620846e+09,'progress','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{"chunks": 2}');
INSERT INTO "event" VALUES(5,1.7954528250719838143e+09,'progress','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{"chunks": 1}');
INSERT INTO "event" VALUES(6,1.7954528251076426506e+09,'look','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{"spp": 8, "relmse": 0.125, "lower": 0.1125, "upper": 0.1375}');
INSERT INTO "event" VALUES(7,1.79545282539237689971e+09,'succeeded','01a20953-ed1d-76f9-82fc-4124ff0577aa',NULL,'{}');
INSERT INTO "event" VALUES(8,1.79545282545303320877e+09,'queued','01a20953-ef6c-72d5-87d6-ff335f76ffcf',NULL,'{"cached": false}');
INSERT INTO "event" VALUES(9,1.79545282547045421603e+09,'running','01a20953-ef6c-72d5-87d6-ff335f76ffcf',NULL,'{}');
INSERT INTO "event" VALUES(10,1.79545282560534453391e+09,'failed','01a20953-ef6c-72d5-87d6-ff335f76ffcf',NULL,'{"code": "python_error", "message": "gave up after 3 attempts: RuntimeError: told to raise", "pointer": ""}');
INSERT INTO "event" VALUES(11,1.79545282565018558505e+09,'queued','01a20953-f031-74de-b2cd-4e0b3b25552a',NULL,'{"cached": false}');
INSERT INTO "event" VALUES(12,1795452825.66489,'cancelled','01a20953-f031-74de-b2cd-4e0b3b25552a',NULL,'{}');
INSERT INTO "event" VALUES(13,1.79545282567495346074e+09,'queued','01a20953-f04a-77a5-a9a5-4549c5b12eed',NULL,'{"cached": false}');
INSERT INTO "event" VALUES(14,1.79545282569540166853e+09,'sweep_queued',NULL,'01a20953-f05b-7a81-b54a-9fd6c0242a74','{"cells": 2}');
INSERT INTO "event" VALUES(15,1.79545282569616055485e+09,'queued','01a20953-f05f-703f-a270-5fd23348ad96','01a20953-f05b-7a81-b54a-9fd6c0242a74','{"cached": false}');
INSERT INTO "event" VALUES(16,1.79545282569721055031e+09,'queued','01a20953-f060-7cae-b1b8-d94719576b56','01a20953-f05b-7a81-b54a-9fd6c0242a74','{"cached": false}');
INSERT INTO "event" VALUES(17,1.79545282570821237563e+09,'running','01a20953-f04a-77a5-a9a5-4549c5b12eed',NULL,'{}');
INSERT INTO "event" VALUES(18,1.79545282627541303633e+09,'progress','01a20953-f04a-77a5-a9a5-4549c5b12eed',NULL,'{"chunks": 10}');
INSERT INTO "event" VALUES(19,1.79545282670820283889e+09,'progress','01a20953-f04a-77a5-a9a5-4549c5b12eed',NULL,'{"chunks": 7}');
INSERT INTO "event" VALUES(20,1.79545282672619652747e+09,'running','01a20953-f05f-703f-a270-5fd23348ad96','01a20953-f05b-7a81-b54a-9fd6c0242a74','{}');
INSERT INTO "event" VALUES(21,1.79545282690842485434e+09,'progress','01a20953-f04a-77a5-a9a5-4549c5b12eed',NULL,'{"chunks": 3}');
INSERT INTO "event" VALUES(22,1.79545282692918324466e+09,'running','01a20953-f060-7cae-b1b8-d94719576b56','01a20953-f05b-7a81-b54a-9fd6c0242a74','{}');
INSERT INTO "event" VALUES(23,1.79545282694558715813e+09,'progress','01a20953-f05f-703f-a270-5fd23348ad96','01a20953-f05b-7a81-b54a-9fd6c0242a74','{"chunks": 6}');
INSERT INTO "event" VALUES(24,1.79545282696173882485e+09,'look','01a20953-f04a-77a5-a9a5-4549c5b12eed',NULL,'{"spp": 64, "relmse": 0.015625, "lower": 0.0140625, "upper": 0.0171875}');
CREATE TABLE film (
	id INTEGER NOT NULL, 
	film_key VARCHAR(64) NOT NULL, 
	geometry_key VARCHAR(64) NOT NULL, 
	scene TEXT NOT NULL, 
	assets TEXT NOT NULL, 
	width INTEGER NOT NULL, 
	height INTEGER NOT NULL, 
	replicates INTEGER NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	prefix_chunks INTEGER NOT NULL, 
	prefix_spp BIGINT NOT NULL, 
	pixel_samples BIGINT NOT NULL, 
	seconds FLOAT NOT NULL, 
	relmse FLOAT, 
	relmse_lower FLOAT, 
	relmse_upper FLOAT, 
	chunks_rendered BIGINT NOT NULL, 
	reports_superseded INTEGER NOT NULL, 
	created FLOAT NOT NULL, 
	CONSTRAINT pk_film PRIMARY KEY (id), 
	CONSTRAINT uq_film_film_key UNIQUE (film_key)
);
INSERT INTO "film" VALUES(1,'f8d9c37606b66478055b2fe67d7f406ab0fc6aebe89e1dcbd681c3d8dd89c414','','{"width":8,"height":16,"value":1.0,"seed":0}','{"root":"/srv/matiere/assets","pins":{}}',8,16,2,'open',6,8,1024,2.48508380100247450172e-02,0.125,0.1125,0.1375,6,0,1.79545282486053109165e+09);
INSERT INTO "film" VALUES(2,'320d0147c7b7b3111398baf33584c154bf01e9492b52c2fe87cc0cb2ab650eaf','','{"width":8,"height":16,"value":1.0,"misdeed":{"kind":"raise","chunk":0},"seed":0}','{"root":"/srv/matiere/assets","pins":{}}',8,16,2,'failed',0,0,0,0.0,NULL,NULL,NULL,0,0,1.79545282545242953307e+09);
INSERT INTO "film" VALUES(3,'1f83ed9ce1d6e24d8c39e5cc285b1a947c6214f37c9e06f5480407a0ca20cc34','','{"width":8,"height":16,"value":3.0,"seed":0}','{"root":"/srv/matiere/assets","pins":{}}',8,16,2,'open',0,0,0,0.0,NULL,NULL,NULL,0,0,1.79545282564936590193e+09);
INSERT INTO "film" VALUES(4,'d0b77c018c0c2ee7434a2805950db4824be328ecd92fad1e4b7da346b00f0d3e','','{"width":8,"height":16,"value":2.0,"chunk_s":0.05,"seed":0}','{"root":"/srv/matiere/assets","pins":{}}',8,16,2,'open',20,64,8192,1.0680099670062190853e+00,0.015625,0.0140625,0.0171875,20,0,1.79545282567436504357e+09);
INSERT INTO "film" VALUES(5,'8c1ad54ca3e344a51f4d83212b7b5ffd70319551eba2a3ce89408ccf96e3e5a6','','{"width":8,"height":16,"value":4,"seed":0}','{"root":"/srv/matiere/assets","pins":{}}',8,16,2,'open',0,0,1024,2.99336999887600541114e-04,NULL,NULL,NULL,6,0,1.79545282569571280481e+09);
INSERT INTO "film" VALUES(6,'29081c664ad57c068a142a52c4be6edc43dc03f37400fe81b9fbc27e38cf8b60','','{"width":8,"height":16,"value":5,"seed":0}','{"root":"/srv/matiere/assets","pins":{}}',8,16,2,'open',0,0,0,0.0,NULL,NULL,NULL,0,0,1.79545282569680309295e+09);
CREATE TABLE idempotency (
	"key" VARCHAR(255) NOT NULL, 
	body_hash VARCHAR(64) NOT NULL, 
	kind VARCHAR(16) NOT NULL, 
	target_id VARCHAR(36) NOT NULL, 
	created FLOAT NOT NULL, 
	CONSTRAINT pk_idempotency PRIMARY KEY ("key")
);
INSERT INTO "idempotency" VALUES('first-key','928f96a7b196a2115d7fab342a204a5e9b09ea24fc22daa88f6af80d006b757b','job','01a20953-ed1d-76f9-82fc-4124ff0577aa',1.79545282487173557279e+09);
CREATE TABLE instance (
	id VARCHAR(36) NOT NULL, 
	pid INTEGER NOT NULL, 
	started FLOAT NOT NULL, 
	ended FLOAT, 
	chunks_present INTEGER NOT NULL, 
	chunks_voided INTEGER NOT NULL, 
	CONSTRAINT pk_instance PRIMARY KEY (id)
);
INSERT INTO "instance" VALUES('01a20953-eafe-7230-b889-484019fd7c74',16668,1.79545282436825871471e+09,NULL,0,0);
CREATE TABLE job (
	id VARCHAR(36) NOT NULL, 
	film_id INTEGER NOT NULL, 
	sweep_id VARCHAR(36), 
	cell INTEGER, 
	parameters TEXT NOT NULL, 
	state VARCHAR(16) NOT NULL, 
	priority INTEGER NOT NULL, 
	stop TEXT NOT NULL, 
	spp_cap BIGINT NOT NULL, 
	output TEXT NOT NULL, 
	label TEXT NOT NULL, 
	cached BOOLEAN NOT NULL, 
	prefix_spp_at_submit BIGINT NOT NULL, 
	created FLOAT NOT NULL, 
	started FLOAT, 
	finished FLOAT, 
	ended_spp BIGINT, 
	ended_seconds FLOAT, 
	ended_relmse FLOAT, 
	ended_relmse_lower FLOAT, 
	ended_relmse_upper FLOAT, 
	stop_reason VARCHAR(32), 
	error_code VARCHAR(64), 
	error_message TEXT, 
	error_pointer TEXT, 
	error_log TEXT, 
	CONSTRAINT pk_job PRIMARY KEY (id), 
	CONSTRAINT fk_job_film_id FOREIGN KEY(film_id) REFERENCES film (id), 
	CONSTRAINT fk_job_sweep_id FOREIGN KEY(sweep_id) REFERENCES sweep (id)
);
INSERT INTO "job" VALUES('01a20953-ed1d-76f9-82fc-4124ff0577aa',1,NULL,NULL,'{}','succeeded',50,'{"spp":8,"seconds":null,"target_error":null}',8,'{}','done',0,0,1.79545282486171221738e+09,1.79545282488892650601e+09,1.79545282539197897909e+09,8,2.48508380100247450172e-02,0.125,0.1125,0.1375,'spp',NULL,NULL,NULL,NULL);
INSERT INTO "job" VALUES('01a20953-ef6c-72d5-87d6-ff335f76ffcf',2,NULL,NULL,'{}','failed',50,'{"spp":8,"seconds":null,"target_error":null}',8,'{}','failed',0,0,1.79545282545279622074e+09,1.79545282547013020516e+09,1.79545282560467863081e+09,NULL,NULL,NULL,NULL,NULL,NULL,'python_error','gave up after 3 attempts: RuntimeError: told to raise','',')
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
Traceback (most recent call last):
  File "/srv/site/matiere/jobs/child.py", line 120, in _serve
    answer = self._answer(request, flag)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/child.py", line 139, in _answer
    answer: JsonDict | None = self._renderer.render(request, self.folder, flag)
                              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 37, in render
    results = list(self._pool.map(one, indices))
              ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 619, in result_iterator
    yield _result_or_cancel(fs.pop())
          ^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 317, in _result_or_cancel
    return fut.result(timeout)
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 456, in result
    return self.__get_result()
           ^^^^^^^^^^^^^^^^^^^
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/_base.py", line 401, in __get_result
    raise self._exception
  File "/root/.pyenv/versions/3.11.7/lib/python3.11/concurrent/futures/thread.py", line 58, in run
    result = self.fn(*self.args, **self.kwargs)
             ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/site/matiere/jobs/rendering.py", line 33, in one
    data = scene.render_chunk(index, flag)
           ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
  File "/srv/tests/jobs/fake_work.py", line 140, in render_chunk
    misdeed(self.scene, index)
  File "/srv/tests/jobs/fake_work.py", line 163, in misdeed
    raise RuntimeError("told to raise")
RuntimeError: told to raise
');
INSERT INTO "job" VALUES('01a20953-f031-74de-b2cd-4e0b3b25552a',3,NULL,NULL,'{}','cancelled',50,'{"spp":1024,"seconds":null,"target_error":null}',1024,'{}','cancelled',0,0,1.79545282564982914925e+09,NULL,1.79545282566464066507e+09,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "job" VALUES('01a20953-f04a-77a5-a9a5-4549c5b12eed',4,NULL,NULL,'{}','running',50,'{"spp":64,"seconds":null,"target_error":null}',64,'{}','half',0,0,1.79545282567470884322e+09,1.79545282570808386801e+09,NULL,64,1.0680099670062190853e+00,0.015625,0.0140625,0.0171875,'spp',NULL,NULL,NULL,NULL);
INSERT INTO "job" VALUES('01a20953-f05f-703f-a270-5fd23348ad96',5,'01a20953-f05b-7a81-b54a-9fd6c0242a74',0,'{"value":4}','running',0,'{"spp":8,"seconds":null,"target_error":null}',8,'{}','4',0,0,1.79545282569596743576e+09,1.79545282672593259809e+09,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "job" VALUES('01a20953-f060-7cae-b1b8-d94719576b56',6,'01a20953-f05b-7a81-b54a-9fd6c0242a74',1,'{"value":5}','running',0,'{"spp":8,"seconds":null,"target_error":null}',8,'{}','5',0,0,1795452825.69703,1.79545282692902255063e+09,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL,NULL);
CREATE TABLE reference (
	owner VARCHAR(16) NOT NULL, 
	owner_id VARCHAR(36) NOT NULL, 
	kind VARCHAR(32) NOT NULL, 
	digest VARCHAR(64) NOT NULL, 
	CONSTRAINT pk_reference PRIMARY KEY (owner, owner_id, kind), 
	CONSTRAINT fk_reference_digest FOREIGN KEY(digest) REFERENCES artifact (digest)
);
INSERT INTO "reference" VALUES('film','1','prefix','8d1cf47c3fc35297e655a28e1a80de178fdf5767427c10665d21c773c8779fb8');
INSERT INTO "reference" VALUES('job','01a20953-ed1d-76f9-82fc-4124ff0577aa','image.png','5d634ad1bfe0378a14b5753da067584683d132f68a88e6765e276542e6c7de33');
INSERT INTO "reference" VALUES('job','01a20953-ed1d-76f9-82fc-4124ff0577aa','image.exr','2c0ac9664f288185a71f589f0f8f646d5d89dd7f8f59db2f93c0a80bfb0e7e5f');
INSERT INTO "reference" VALUES('job','01a20953-ed1d-76f9-82fc-4124ff0577aa','report.json','98b25374b0adef3c71b61771a49dc2b0549ca6f2406f61cdab2ea50c6c0828fc');
INSERT INTO "reference" VALUES('job','01a20953-ed1d-76f9-82fc-4124ff0577aa','error.svg','d4dc56669143034f31aa309635d4113d9ad76a02b1739da22c965ed2049be9e6');
INSERT INTO "reference" VALUES('attempt','10','chunks','255ec2d6c79662eacd3613dd49dd863d13c796ec3756ecdbf70a88eeaa0f9072');
INSERT INTO "reference" VALUES('film','4','prefix','6ad93333a0ebb9f36a8a416a37493db6555a65a3d38e0a18f0a2307b42d8f20e');
INSERT INTO "reference" VALUES('job','01a20953-f04a-77a5-a9a5-4549c5b12eed','film','6ad93333a0ebb9f36a8a416a37493db6555a65a3d38e0a18f0a2307b42d8f20e');
CREATE TABLE sweep (
	id VARCHAR(36) NOT NULL, 
	label TEXT NOT NULL, 
	mode VARCHAR(16) NOT NULL, 
	axes TEXT NOT NULL, 
	base TEXT NOT NULL, 
	cells INTEGER NOT NULL, 
	columns INTEGER NOT NULL, 
	created FLOAT NOT NULL, 
	finished FLOAT, 
	CONSTRAINT pk_sweep PRIMARY KEY (id)
);
INSERT INTO "sweep" VALUES('01a20953-f05b-7a81-b54a-9fd6c0242a74','waiting','grid','[{"pointer":["/value"],"label":"value","values":[4,5],"labels":["4","5"]}]','{"width":8,"height":16,"value":1.0}',2,2,1.79545282569135499005e+09,NULL);
CREATE INDEX ix_artifact_state ON artifact (state);
CREATE INDEX ix_event_job_id ON event (job_id);
CREATE INDEX ix_event_sweep_id ON event (sweep_id);
CREATE INDEX ix_attempt_film_id ON attempt (film_id);
CREATE INDEX ix_attempt_state ON attempt (state);
CREATE INDEX ix_job_film_id ON job (film_id);
CREATE INDEX ix_job_queue ON job (state, priority, id);
CREATE INDEX ix_job_sweep ON job (sweep_id, cell);
CREATE INDEX ix_reference_digest ON reference (digest);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('event',24);
COMMIT;
